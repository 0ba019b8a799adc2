"""What is kept of what is heard: everything counted, little held, each host in its turn."""

import pytest

from services.router.samples import MOST_BYTES_OF_ONE, MOST_FRAMES, Samples, host_of
from services.runtime.bus import Frame, Membership


def frame(host: str, size: int = 10) -> Frame:
    return Frame(f"babble/r/status/actor/actor-{host}-00000001", bytes(size))


@pytest.mark.parametrize(
    ("life", "host"),
    [
        ("actor-lab-00000001", "lab"),
        ("actor-lab_2-00000001", "lab_2"),
        ("actor-00000001", None),
        ("coordinator-00000001", None),
        ("actor--00000001", None),
        ("xactor-lab-00000001", None),
        (f"actor-{'a' * 25}-0", None),
    ],
)
def test_the_host_is_in_the_life(life: str, host: str | None) -> None:
    assert host_of(f"babble/r/status/actor/{life}") == host


def test_all_are_counted_and_the_newest_are_kept() -> None:
    samples = Samples()
    for _ in range(100):
        samples.put(frame("lab"))
    samples.put(frame("den"))
    samples.put(Membership("babble/r/alive/actor/actor-lab-1", True))
    assert samples.counts() == {"lab": 100, "den": 1}
    assert samples.counts() == {}
    assert samples.dropped == 100 - MOST_FRAMES


def test_hosts_are_looked_at_in_turn() -> None:
    samples = Samples()
    for host in ("lab", "lab", "lab", "den", "den"):
        samples.put(frame(host))
    looked = [samples.next_frame() for _ in range(6)]
    assert [found[0] if found else None for found in looked] == ["lab", "den", "lab", "den", "lab", None]


def test_large_frames_of_one_host_leave_room_for_the_others() -> None:
    samples = Samples()
    for _ in range(MOST_FRAMES):
        samples.put(frame("lab", MOST_BYTES_OF_ONE // 2))
    samples.put(frame("den", 2 * MOST_BYTES_OF_ONE))
    kept: dict[str, int] = {}
    while (found := samples.next_frame()) is not None:
        kept[found[0]] = kept.get(found[0], 0) + len(found[1].data)
    assert kept == {"lab": MOST_BYTES_OF_ONE, "den": 2 * MOST_BYTES_OF_ONE}
    assert samples.dropped == MOST_FRAMES - 2


def test_many_hosts_with_the_largest_frames_cannot_fill_the_memory() -> None:
    samples = Samples()
    data = bytes(60 << 20)
    for number in range(20):
        samples.put(Frame(f"babble/r/status/actor/actor-h{number}-00000001", data))
    assert sum(samples.counts().values()) == 20
    assert samples.dropped == 19
    assert samples.next_frame() is not None
    assert samples.next_frame() is None
