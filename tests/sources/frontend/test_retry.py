from chachart.sources.frontend.retry import Backoff


def test_waits_double_up_to_the_longest_and_begin_anew_after_a_success():
    now = [0.0]
    backoff = Backoff(1.0, lambda: now[0])
    assert backoff.wait_s() == 0.0
    waits = []
    for _ in range(6):
        backoff.failed()
        waits.append(backoff.wait_s())
        now[0] += waits[-1]
        assert backoff.wait_s() == 0.0
    assert [round(w, 6) for w in waits] == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    backoff.succeeded()
    backoff.failed()
    assert round(backoff.wait_s(), 6) == 0.1
