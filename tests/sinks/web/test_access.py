from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from websockets.datastructures import Headers

from chachart.node.net.endpoints import is_loopback
from chachart.node.net.security import Role, SecuritySettings, Tokens
from chachart.sinks.control import ControlSettings
from chachart.sinks.metrics import MetricsSettings
from chachart.sinks.view.sink import ViewSettings
from chachart.sinks.web.access import Access, Refusal

TOKEN = "a-token-of-some-length"
HERE = {"Host": "127.0.0.1:8080"}


def status(
    headers: dict[str, str], *, peer: str = "127.0.0.1", token: str | None = TOKEN, query: str = ""
) -> int:
    admitted = Access(Tokens(token), trust_local=True).admit(peer, Headers(headers), query or None)
    return admitted.status if isinstance(admitted, Refusal) else 200


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:8080", "localhost:8080", "LOCALHOST", "[::1]:8080"])
def test_people_on_this_machine_need_no_token(host: str) -> None:
    assert status({"Host": host}, token=None) == 200
    assert status({"Host": host, "Origin": f"http://{host}"}, peer="::1") == 200


@pytest.mark.parametrize(
    "host", ["", "evil.example", "127.0.0.1.evil.example:8080", "192.168.1.5:8080", "[::1"]
)
def test_a_foreign_host_name_is_no_local_request(host: str) -> None:
    assert status({"Host": host}) == 401
    assert status({"Host": host}, token=None) == 403


@pytest.mark.parametrize("header", ["Forwarded", "X-Forwarded-For", "x-real-ip", "Via"])
def test_what_a_proxy_passed_on_is_no_local_request(header: str) -> None:
    assert status({**HERE, header: "for=10.0.0.7"}) == 401


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "file://"])
def test_pages_of_another_site_are_turned_away_even_with_the_token(origin: str) -> None:
    assert status({**HERE, "Origin": origin}) == 403
    assert status({**HERE, "Origin": origin}, query=TOKEN) == 403


def test_others_need_the_token() -> None:
    there = {"Host": "node.lab:8080"}
    assert status(there, peer="10.0.0.7") == 401
    assert status(there, peer="10.0.0.7", token=None) == 403
    assert status(HERE, peer="10.0.0.7") == 401
    assert status(there, peer="10.0.0.7", query=TOKEN) == 200
    assert status({**there, "Authorization": f"Bearer {TOKEN}"}, peer="10.0.0.7") == 200
    cookie = Tokens(TOKEN).cookie(Role.STEERER)
    assert status({**there, "Cookie": f"other=1; chachart_token={cookie}"}, peer="10.0.0.7") == 200
    assert status({**there, "Cookie": f"chachart_token={TOKEN}"}, peer="10.0.0.7") == 401


PRINTABLE = st.text(alphabet=st.characters(min_codepoint=32, max_codepoint=255, exclude_categories=["Cc"]))


@given(st.text(), PRINTABLE, PRINTABLE)
def test_no_other_token_opens(query: str, bearer: str, cookie: str) -> None:
    headers = {"Host": "node.lab", "Authorization": f"Bearer {bearer}", "Cookie": f"chachart_token={cookie}"}
    if TOKEN not in (query, bearer.strip(), cookie):
        assert status(headers, peer="10.0.0.7", query=query) == 401


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "node.lab"])
def test_listening_to_others_without_a_token_is_a_mistake(host: str) -> None:
    assert not is_loopback(host)
    for settings in (ViewSettings, MetricsSettings):
        assert "a token must be set" in settings(host=host).exposure(SecuritySettings())[0]
        assert settings(host=host).exposure(SecuritySettings(token=TOKEN)) == []
        assert settings(host=host, token=TOKEN).exposure(SecuritySettings()) == []
    endpoint = f"tcp://{f'[{host}]' if ':' in host else host}:5557"
    control = ControlSettings(endpoint=endpoint)
    named = SecuritySettings(without_keys=(endpoint,))
    assert "set keys" in control.exposure(SecuritySettings(token=TOKEN))[0]
    assert "a token must be set" in control.exposure(named)[0]
    assert ControlSettings(endpoint=endpoint, token=TOKEN).exposure(named) == []


def test_a_token_has_some_length_and_is_not_shown() -> None:
    with pytest.raises(ValidationError, match="at least 16"):
        ViewSettings(token="short")
    assert TOKEN not in repr(ViewSettings(token=TOKEN))
    assert TOKEN not in repr(SecuritySettings(token=TOKEN, read_token=TOKEN[::-1]))
    assert TOKEN not in repr(Tokens(TOKEN))
