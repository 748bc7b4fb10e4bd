"""The cache never gives a reply of another generation, nor an old one, and stays small."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.reply_cache import ReplyCache

requests = st.sampled_from([b"a", b"bb", b"ccc"])
steps = st.lists(
    st.one_of(
        st.tuples(st.just("put"), requests, st.binary(max_size=300)),
        st.tuples(st.just("get"), requests, st.just(b"")),
        st.tuples(st.just("change"), st.just(b""), st.just(b"")),
        st.tuples(st.just("wait"), st.just(b""), st.just(b"")),
    ),
    max_size=60,
)


@given(steps)
def test_it_behaves_like_its_model(taken: list[tuple[str, bytes, bytes]]) -> None:
    capacity = 2_000
    cache = ReplyCache(capacity=capacity, longest=1.0)
    model: dict[bytes, tuple[int, float, bytes]] = {}
    generation, now = 0, 0.0
    for step, request, reply in taken:
        match step:
            case "put":
                cache.put(request, reply, generation, now)
                model[request] = (generation, now, reply)
            case "change":
                generation += 1
            case "wait":
                now += 0.4
            case _:
                found = cache.get(request, generation, now)
                if found is not None:
                    known = model[request]
                    assert found == known[2]
                    assert known[0] == generation
                    assert now - known[1] <= 1.0
        assert 0 <= cache.size <= capacity


def test_a_reply_is_found_again() -> None:
    cache = ReplyCache()
    cache.put(b"q", b"r", 1, 0.0)
    assert cache.get(b"q", 1, 0.5) == b"r"
    assert cache.get(b"q", 1, 1.5) is None
    assert cache.get(b"q", 2, 0.5) is None
    assert cache.get(b"q", 1, 0.5) is None


def test_a_reply_that_was_overtaken_is_not_kept() -> None:
    cache = ReplyCache()
    assert cache.get(b"q", 2, 0.0) is None
    cache.put(b"q", b"from before the change", 1, 0.0)
    assert cache.get(b"q", 1, 0.0) is None


def test_one_that_is_too_large_is_not_kept() -> None:
    cache = ReplyCache(capacity=1_000)
    cache.put(b"q", b"x" * 1_000, 1, 0.0)
    assert cache.get(b"q", 1, 0.0) is None
    assert cache.size == 0


def test_many_different_requests_stay_within_the_capacity() -> None:
    cache = ReplyCache(capacity=100_000)
    for number in range(10_000):
        cache.put(b"%d" % number, b"x" * 100, 1, 0.0)
        assert cache.size <= 100_000
    assert cache.get(b"9999", 1, 0.0) is not None
