from __future__ import annotations

import pytest
import zmq

from chachart.node.data.errors import SetupError
from chachart.node.net.endpoints import bind, bind_problems, connect


@pytest.mark.parametrize("port", ["65536", "99999", "4294967376"])
def test_a_port_beyond_16_bits_is_not_some_other_port(port: str) -> None:
    """ZeroMQ would listen on `port` modulo 65536, where nobody connects."""
    endpoint = f"tcp://127.0.0.1:{port}"
    assert "65535" in bind_problems(endpoint)[0]
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        with pytest.raises(SetupError, match="65535"):
            bind(socket, endpoint)
        with pytest.raises(SetupError, match="65535"):
            connect(socket, endpoint)


def test_what_is_free_is_no_problem() -> None:
    assert bind_problems("tcp://127.0.0.1:0") == []
    assert bind_problems("tcp://127.0.0.1:*") == []


def test_a_taken_port_is_a_problem() -> None:
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        assert "in use" in bind_problems(bind(socket, "tcp://127.0.0.1:0"))[0]


def test_a_spare_port_is_taken_instead_of_one_in_use() -> None:
    with zmq.Context() as context, context.socket(zmq.PUB) as first, context.socket(zmq.PUB) as second:
        taken = bind(first, "tcp://127.0.0.1:0")
        assert bind_problems(taken, spare_ports=50) == []
        port = int(bind(second, taken, spare_ports=50).rpartition(":")[2])
        assert 0 < port - int(taken.rpartition(":")[2]) <= 50
