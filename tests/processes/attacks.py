"""A forbidden act, done for real against a router, and what rightful witnesses notice of it.

That nothing came proves nothing by itself. So the router answers the attacker after the act, and then
an honest process speaks on the same way: once that is there, the other would have been there before.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from protocol.keys import ROOT
from services.runtime.bus import Arrival, Frame, Inbox, Membership, Question
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.credentials_stage import ATTACKER
from tests.processes.owned import Owner, Process, wait_for

OTHER_LIFE = "actor-other-00000001"
"""Of an honest actor."""
HONEST = {
    "phase": ("coordinator", "phase"),
    "settings": ("coordinator", "settings"),
    "model": ("encoder_learner", "model/encoder/body"),
    "ack": ("encoder_learner", f"ack/{OTHER_LIFE}/encoder_learner"),
    "segment": ("actor.other", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    "rows": ("actor.other", f"segment/recorder/all/{OTHER_LIFE}"),
    "status": ("actor.other", f"status/actor/{OTHER_LIFE}"),
    "view": ("actor.other", f"view/posture/{OTHER_LIFE}"),
}
"""By kind, and for the segments of the recorder, who rightly says what, below babble/<run>/."""
WITNESSES = {
    "phase": ("actor.other", "phase"),
    "settings": ("actor.other", "settings"),
    "model": ("actor.other", "model/*/*"),
    "ack": ("actor.other", f"ack/{OTHER_LIFE}/*"),
    "segment": ("encoder_learner", "segment/encoder_learner/*/*"),
    "rows": ("recorder", "segment/recorder/*/*"),
    "status": ("coordinator", "status/*/*"),
    "view": ("dashboard", "view/*/*"),
}
"""By kind, who rightly hears what."""
RETAINED = ("phase", "settings", "model")
COMMAND = "command/coordinator"


@dataclass(frozen=True)
class Act:
    """Something that a client does, right or wrong."""

    who: str
    """the identity in its certificate"""
    does: str
    """as in the table of rights, or "deletes" """
    key: str
    """below babble/<run>/, unless it begins with * or @"""
    calls_itself: str = "client"

    def __str__(self) -> str:
        disguise = "" if self.calls_itself == "client" else f" as a {self.calls_itself}"
        return f"{self.who}{disguise} {self.does} {self.key}"


@dataclass
class Hall:
    """A router, its honest processes by identity, and the credentials that an attacker has stolen."""

    endpoint: str
    owner: Owner
    buses: dict[str, ZenohBus]
    stolen: Callable[[str], Path | None]
    runs: int = 0

    def attack(self, act: Act) -> list[str]:
        """All that anybody noticed of the act, the attacker's gains included; [] if it failed.

        Each attack has a run of its own.
        """
        self.runs += 1
        run = f"run{self.runs}"
        match act.does:
            case "says" | "deletes" | "retains":
                return self._speak(act, run)
            case "announces":
                return self._announce(act, run)
            case "asks":
                return self._ask(act, run)
            case "answers":
                return self._answer(act, run)
        return self._spy(act, run)

    def say(self, kind: str, run: str, word: bytes) -> None:
        """An honest message of a kind."""
        who, key = HONEST[kind]
        self.buses[who].publish(key.split("/")[0], below(run, key), word)

    def hear(self, kind: str, run: str) -> Inbox:
        """What the rightful witness of a kind hears from now on."""
        inbox = Inbox()
        who, key_expr = WITNESSES[kind]
        self.buses[who].subscribe(key_expr.split("/")[0], below(run, key_expr), inbox)
        return inbox

    def _speak(self, act: Act, run: str) -> list[str]:
        kind = act.key.split("/")[0]
        inbox = self.hear(kind, run)

        def first_heard() -> bool:
            self.say(kind, run, b"first")
            return len(inbox) > 0

        wait_for(f"the honest {kind}", first_heard)
        attacker = self._begin(act, run)
        inboxes = [inbox, self.hear(kind, run)] if kind in RETAINED else [inbox]
        self.say(kind, run, b"last")
        honest = [Frame(below(run, HONEST[kind][1]), word) for word in (b"first", b"last")]
        noticed = [seen for each in inboxes for seen in all_until(each, honest[1])]
        attacker.kill()
        return [str(seen) for seen in noticed if seen not in honest]

    def _announce(self, act: Act, run: str) -> list[str]:
        inbox = self._watch(run)
        attacker = self._begin(act, run)
        honest = self._announce_honestly(run)
        noticed = all_until(inbox, honest)
        attacker.kill()
        return [str(seen) for seen in noticed if seen != honest]

    def _ask(self, act: Act, run: str) -> list[str]:
        inbox = Inbox()
        self.buses["coordinator"].answer(below(run, COMMAND), inbox)
        for kind in RETAINED:
            heard = self.hear(kind, run)
            self.say(kind, run, b"secret")
            wait_for(f"the honest {kind}", heard.take)
        attacker = self._begin(act, run)
        questions, _ = self._ask_honestly(run, inbox)
        attacker.kill()
        return [*(seen for seen in questions if "honest" not in seen), *gains(attacker)]

    def _answer(self, act: Act, run: str) -> list[str]:
        attacker = self._begin(act, run)
        forged = self.buses["launcher"].ask(below(run, act.key), b"honest", 2.0)
        attacker.kill()
        inbox = Inbox()
        self.buses["coordinator"].answer(below(run, COMMAND), inbox)
        _, answer = self._ask_honestly(run, inbox)
        assert answer == b"honest"
        return [*([] if forged is None else [str(forged)]), *gains(attacker)]

    def _spy(self, act: Act, run: str) -> list[str]:
        """The attacker listens while everybody does what they may."""
        inboxes = {kind: self.hear(kind, run) for kind in HONEST}
        watching = self._watch(run)
        attacker = self._begin(act, run)
        for kind, inbox in inboxes.items():

            def heard(kind: str = kind, inbox: Inbox = inbox) -> bool:
                self.say(kind, run, b"secret")
                return len(inbox) > 0

            wait_for(f"the honest {kind}", heard)
        all_until(watching, self._announce_honestly(run))
        rounds = len(attacker.out)
        wait_for("what went to the attacker before", lambda: len(attacker.out) >= rounds + 3)
        attacker.kill()
        return gains(attacker)

    def _begin(self, act: Act, run: str) -> Process:
        """The attacker, after the act, and after the router has answered it something else."""
        shown = str(self.stolen(act.who) or "")
        given = (self.endpoint, shown, act.calls_itself, act.does, below(run, act.key))
        attacker = self.owner.start_code(str(act), ATTACKER, *given)
        attacker.expect("door 1")
        return attacker

    def _watch(self, run: str) -> Inbox:
        inbox = Inbox()
        self.buses["coordinator"].watch(below(run, "alive/*/*"), inbox)
        return inbox

    def _announce_honestly(self, run: str) -> Membership:
        key = below(run, f"alive/actor/{OTHER_LIFE}")
        self.buses["actor.other"].announce(key)
        return Membership(key, True)

    def _ask_honestly(self, run: str, inbox: Inbox) -> tuple[list[str], bytes]:
        """All that the coordinator was asked until it has answered the launcher, and the answer."""
        asked: list[str] = []

        def answered() -> bytes | None:
            reply = pool.submit(self.buses["launcher"].ask, below(run, COMMAND), b"honest", 1.0)
            while not reply.done():
                question = inbox.take()
                if isinstance(question, Question):
                    asked.append(str(question.data))
                    if question.data == b"honest":
                        question.reply(b"honest")
            return reply.result()

        with ThreadPoolExecutor(1) as pool:
            return asked, wait_for("an honest answer", answered)


def below(run: str, key: str) -> str:
    """The whole key."""
    return key if key[0] in "*@" else f"{ROOT}/{run}/{key}"


def all_until(inbox: Inbox, last: Arrival) -> list[Arrival]:
    """Everything that came up to `last`, which must come."""
    taken: list[Arrival] = []

    def arrived() -> bool:
        taken.extend(inbox.take_all())
        return last in taken

    wait_for(str(last), arrived)
    return taken


def gains(attacker: Process) -> list[str]:
    """What reached the attacker."""
    return [line for line in attacker.out if line.startswith(("HEARD", "ASKED"))]
