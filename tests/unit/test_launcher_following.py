"""Following a run over a bus within this process: connecting, moving, waiting, ending."""

import json
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from protocol import keys
from protocol.codec import encode
from protocol.messages import ALL_BLOCKS, Phase, PhaseAnnounced
from services.launcher import following
from services.launcher.following import Follower
from services.launcher.interrupts import Interrupts
from services.launcher.members import Picture
from services.launcher.reaching import Reach
from services.launcher.run_folder import RunFolder
from services.runtime.bus import Bus, Wakeup
from services.runtime.errors import BusError, RefusedError
from services.runtime.memory_bus import MemoryBus
from services.runtime.settings import RunSettings

MOST_LOOKS = 400
DONE = json.dumps({"secs": 5.0, "what": "phase", "text": "done (level 0, iteration 4, term 9)"}) + "\n"


class Plot:
    """A display that at each look tries the next step of a story, until that has happened."""

    def __init__(self, *steps: Callable[[Picture], bool | None]) -> None:
        self.told: list[str] = []
        self._steps = [*steps]
        self._looks = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to put in order."""

    def show(self, picture: Picture, now_secs: float) -> None:
        self._looks += 1
        assert self._looks < MOST_LOOKS, f"it never went on from {self.told}"
        self.told += picture.news
        picture.news.clear()
        if self._steps and self._steps[0](picture) is not False:
            self._steps.pop(0)


class World:
    """A run on a bus of its own, with a coordinator, and a folder that a launcher holds."""

    def __init__(self, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.hub = MemoryBus()
        self.folder = RunFolder.create(RunSettings(scenario="s"), path, [], run="r")
        self.folder.note_endpoint("tcp/127.0.0.1:1")
        self.coordinator = self.hub.connect("coordinator-1")
        self.met: list[tuple[str, str]] = []
        """(address, life) of each connection that the follower made"""
        self.absent: set[str] = set()
        """addresses at which there is no router"""
        monkeypatch.setattr(following, "ZenohBus", self._connect)
        monkeypatch.setattr(following, "POLL_SECS", 0.01)
        monkeypatch.setattr(following, "AGAIN_SECS", 0.01)
        monkeypatch.setattr(following, "FOLDER_SECS", 0.01)
        monkeypatch.setattr(following, "SCORES_SECS", 0.0)

    def follow(self, plot: Plot, interrupts: Interrupts | None = None, connect: str | None = None) -> bool:
        asked = Reach(run="r", folder=self.folder, connect=connect)
        return Follower(asked, None, plot).follow(interrupts or Interrupts())

    def says(self, phase: Phase) -> Callable[[Picture], bool | None]:
        """A step: the coordinator is there and announces a phase."""

        def step(picture: Picture) -> bool | None:
            if not self.met:
                return False
            fields = {"run": "r", "block": ALL_BLOCKS, "life": "coordinator-1", "seq": 0, "blocks": {}}
            message = PhaseAnnounced.model_validate(
                {**fields, "term": list(Phase).index(phase), "phase": phase}
            )
            self.coordinator.announce(keys.alive("r", "coordinator", "coordinator-1"))
            self.coordinator.publish("phase", keys.phase("r"), encode(message))
            return None

        return step

    def _connect(self, endpoint: str, life: str, wakeup: Wakeup, secs: float, credential: object) -> Bus:
        assert credential is None
        if endpoint in self.absent:
            raise BusError(f"no router answered at {endpoint}")
        self.met.append((endpoint, life))
        return self.hub.connect(life, wakeup)


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return World(tmp_path / "run", monkeypatch)


def test_it_follows_until_the_coordinator_says_that_it_is_done(world: World) -> None:
    plot = Plot(world.says(Phase.WALK), world.says(Phase.DONE))
    assert world.follow(plot, connect="tcp/127.0.0.1:1")
    assert [words for words in plot.told if words.isupper()] == ["WALK", "DONE"]


def test_a_router_that_is_not_there_yet_is_told_once_and_tried_again(world: World) -> None:
    world.absent.add("tcp/127.0.0.1:1")
    tries = iter(range(20))

    def wait(picture: Picture) -> bool | None:
        if next(tries, None) is not None:
            return False
        assert not picture.linked
        assert "no router answered" in picture.errors["router"]
        world.absent.clear()
        return None

    plot = Plot(wait, world.says(Phase.DONE))
    assert world.follow(plot, connect="tcp/127.0.0.1:1")
    assert plot.told.count("no router answered at tcp/127.0.0.1:1; trying again") == 1


def test_a_router_that_will_never_let_it_in_ends_it(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Bus:
        raise RefusedError("cannot connect to tls/lab:7447: another authority")

    monkeypatch.setattr(following, "ZenohBus", refuse)
    with pytest.raises(RefusedError, match="another authority"):
        world.follow(Plot(), connect="tcp/127.0.0.1:1")


def test_a_resumed_run_is_found_at_its_new_address(world: World) -> None:
    def resumed(picture: Picture) -> bool | None:
        if not picture.members():
            return False
        world.hub.cut(world.met[0][1])
        world.folder.note_endpoint("tcp/127.0.0.1:2")
        return None

    def met_again(picture: Picture) -> bool | None:
        return None if len(world.met) == 2 and picture.linked else False

    plot = Plot(world.says(Phase.WALK), resumed, met_again, world.says(Phase.DONE))
    with world.folder.locked():
        assert world.follow(plot)
    assert [endpoint for endpoint, _ in world.met] == ["tcp/127.0.0.1:1", "tcp/127.0.0.1:2"]
    lost, back = (
        plot.told.index(words) for words in ("the link to the router is lost", "the router is back")
    )
    assert lost < back


def test_a_run_that_ended_while_nobody_listened_is_seen_in_its_folder(world: World) -> None:
    def ended(picture: Picture) -> bool | None:
        (world.folder.path / "events.jsonl").write_text(DONE)
        return None

    world.absent.add("tcp/127.0.0.1:1")
    assert world.follow(Plot(ended), connect="tcp/127.0.0.1:1")


def test_a_missing_coordinator_is_told_once_each_time(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "ALONE_SECS", 0.1)

    def told(times: int) -> Callable[[Picture], bool | None]:
        return lambda _: sum("no coordinator of r" in words for words in plot.told) == times or False

    def gone(picture: Picture) -> bool | None:
        if picture.announced is None:
            return False
        world.coordinator.close()
        world.coordinator = world.hub.connect("coordinator-1")
        return None

    plot = Plot(told(1), world.says(Phase.WALK), gone, told(2), world.says(Phase.DONE))
    assert world.follow(plot, connect="tcp/127.0.0.1:1")
    first, second = (words for words in plot.told if "no coordinator" in words)
    assert first.endswith("waiting for one (is that the run's name?)")
    assert second.endswith("waiting for one (the run goes on with it)")


def test_a_signal_ends_it_at_the_next_look(world: World) -> None:
    interrupts = Interrupts()
    assert not world.follow(Plot(lambda _: interrupts.numbers.append(15)), interrupts, "tcp/127.0.0.1:1")
