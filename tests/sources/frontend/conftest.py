import hypothesis.strategies as st
import pytest
from hypothesis.extra import numpy as hnp

from chachart.node.data.geometry import ArrayGeometry
from chachart.sources.frontend.packet import CsiPacket, Heartbeat, Hello, SampleFormat


@pytest.fixture(scope="session")
def array() -> ArrayGeometry:
    return ArrayGeometry("lab", 4, 3, 2e9, 312_500.0, 0.075)


def finite_samples(fmt: SampleFormat) -> st.SearchStrategy:
    shape = st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(2))
    if fmt is SampleFormat.FLOAT32:
        elements = st.floats(width=32, allow_nan=False, allow_infinity=False)
        return hnp.arrays(fmt.dtype, shape, elements=elements)
    return hnp.arrays(fmt.dtype, shape)


SEQ = st.integers(0, 2**32 - 1)
TIME = st.integers(0, 2**63 - 1)
POSITIVE = st.floats(1e-3, 1e12)
CSI = st.sampled_from(SampleFormat).flatmap(
    lambda fmt: st.builds(
        CsiPacket,
        SEQ,
        TIME,
        st.integers(0, 2**64 - 1),
        finite_samples(fmt),
        st.floats(2**-20, 2**20, width=32),
    )
)
HELLO = st.builds(
    Hello,
    SEQ,
    TIME,
    st.integers(1, 65535),
    st.integers(1, 65535),
    POSITIVE,
    POSITIVE,
    st.floats(0, 100, width=32),
    st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=16),
)
PLACE = st.tuples(*[st.floats(-100, 100, width=32)] * 3)
HELLO_WITH_ELEMENTS = st.lists(PLACE, min_size=1, max_size=8).map(
    lambda places: Hello(1, 2, len(places), 3, 1e9, 1e6, 0.5, "A1", tuple(places))
)
HEARTBEAT = st.builds(Heartbeat, SEQ, TIME)


@pytest.fixture(scope="session")
def packets() -> st.SearchStrategy:
    """Any packet a front-end may send."""
    return st.one_of(CSI, HELLO, HELLO_WITH_ELEMENTS, HEARTBEAT)
