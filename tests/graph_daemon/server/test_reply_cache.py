"""The cache gives no reply that was overtaken, but for the short time that is allowed."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from play_launch.graph_daemon.server.reply_cache import HOLD, LONGEST_HOLD, ReplyCache

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


@given(steps, st.floats(0.0, 0.2), st.sampled_from([0.01, 0.1, 0.4]))
def test_it_behaves_like_its_model(
    taken: list[tuple[str, bytes, bytes]], effort: float, pause: float
) -> None:
    capacity = 2_000
    cache = ReplyCache(capacity=capacity, longest=1.0)
    model: dict[bytes, tuple[int, float, bytes]] = {}
    generation, now = 0, 0.0
    for step, request, reply in taken:
        match step:
            case "put":
                cache.put(request, reply, generation, now, now + effort)
                model[request] = (generation, now, reply)
                now += effort
            case "change":
                generation += 1
            case "wait":
                now += pause
            case _:
                found = cache.get(request, generation, now)
                if found is not None:
                    of, asked, text = model[request]
                    assert found == text
                    held = asked + effort + min(HOLD * effort, LONGEST_HOLD)
                    assert of == generation or now < held
                    assert now - asked <= 1.0
        assert 0 <= cache.size <= capacity


def test_a_reply_is_found_again() -> None:
    cache = ReplyCache()
    cache.put(b"q", b"r", 1, 0.0, 0.0)
    assert cache.get(b"q", 1, 0.5) == b"r"
    assert cache.get(b"q", 1, 1.5) is None
    assert cache.get(b"q", 2, 0.5) is None


def test_a_reply_that_took_long_outlives_a_change_in_proportion() -> None:
    cache = ReplyCache()
    cache.put(b"q", b"r", 1, 0.0, 0.01)
    assert cache.get(b"q", 2, 0.04) == b"r"
    assert cache.get(b"q", 2, 0.06) is None
    assert cache.get(b"q", 1, 0.06) == b"r"


def test_it_outlives_a_change_by_a_quarter_of_a_second_at_most() -> None:
    cache = ReplyCache()
    cache.put(b"q", b"r", 1, 0.0, 0.5)
    assert cache.get(b"q", 2, 0.74) == b"r"
    assert cache.get(b"q", 2, 0.76) is None


def test_a_reply_that_was_overtaken_while_it_was_written_is_not_given() -> None:
    cache = ReplyCache()
    cache.put(b"q", b"from before the change", 1, 0.0, 0.0)
    assert cache.get(b"q", 2, 0.001) is None


def test_one_that_is_too_large_is_not_kept() -> None:
    cache = ReplyCache(capacity=1_000)
    cache.put(b"q", b"x" * 1_000, 1, 0.0, 0.0)
    assert cache.get(b"q", 1, 0.0) is None
    assert cache.size == 0


def test_many_different_requests_stay_within_the_capacity() -> None:
    cache = ReplyCache(capacity=100_000)
    for number in range(10_000):
        cache.put(b"%d" % number, b"x" * 100, 1, 0.0, 0.0)
        assert cache.size <= 100_000
    assert cache.get(b"9999", 1, 0.0) is not None
