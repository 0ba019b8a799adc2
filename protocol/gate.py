"""The one door through which a service takes frames."""

import hashlib
from collections.abc import Collection
from itertools import zip_longest

from protocol import keys
from protocol.codec import decode
from protocol.messages import MESSAGES, Message, Model, Segment
from protocol.refusal import MAX_SENTENCE_CHARS, Reason, Refused, clip, shown


class Gate:
    """Admits the frames of one run, of the kinds its service expects; counts the rest by reason.

    Give the interface's `fingerprint` where segments or models come in.
    """

    def __init__(self, run: str, kinds: Collection[str], fingerprint: str | None = None) -> None:
        unknown = set(kinds) - set(MESSAGES)
        if unknown or isinstance(kinds, str):
            raise ValueError(f"a gate needs a set of kinds out of {sorted(MESSAGES)}, not {kinds!r}")
        self._run = run
        self._kinds = frozenset(kinds)
        self._fingerprint = fingerprint
        self.admitted = 0
        """Frames let through."""
        self.refused: dict[str, int] = {}
        """Frames refused, by `Reason`; a total of this life."""
        self.last_refusal = ""
        """The last refusal in one sentence of bounded length, or empty."""

    def admit(self, key: str, data: bytes) -> Message | None:
        """The message of a frame heard on a key, or None if it is refused. Never raises."""
        try:
            message = decode(data)
            self._check(key, message)
        except Refused as refusal:
            self.refuse(refusal)
            return None
        self.admitted += 1
        return message

    def refuse(self, refusal: Refused) -> None:
        """Count a frame that was let through and turned out unwanted after all (stale, duplicate...)."""
        name = refusal.reason.value
        self.refused[name] = self.refused.get(name, 0) + 1
        self.last_refusal = clip(str(refusal), MAX_SENTENCE_CHARS)

    def _check(self, key: str, message: Message) -> None:
        if message.run != self._run:
            raise Refused(
                Reason.FOREIGN_RUN,
                f"a {message.kind} of run {message.run!r} came to run {self._run!r}; give each run its id",
            )
        _check_key(key, message)
        if message.kind not in self._kinds:
            raise Refused(
                Reason.UNEXPECTED, f"a {message.kind} came where only {sorted(self._kinds)} are expected"
            )
        if isinstance(message, Segment | Model):
            self._check_fingerprint(message)
        if isinstance(message, Model):
            _check_digest(message)

    def _check_fingerprint(self, message: Segment | Model) -> None:
        if self._fingerprint is not None and message.fingerprint != self._fingerprint:
            raise Refused(
                Reason.WRONG_FINGERPRINT,
                f"a {message.kind} from {message.life} was made for the interface {message.fingerprint}, but "
                f"this process has {self._fingerprint}; start both with the same scenario",
            )


def _check_key(key: str, message: Message) -> None:
    wanted = keys.of(message)
    if key == wanted:
        return
    if not all(a == b or (b == "*" and a) for a, b in zip_longest(key.split("/"), wanted.split("/"))):
        raise Refused(
            Reason.WRONG_KEY, f"a {message.kind} came on {shown(key)}, but its header belongs to {wanted!r}"
        )


def _check_digest(model: Model) -> None:
    found = hashlib.sha256(model.arrays["onnx"].data).hexdigest()
    if found != model.digest:
        raise Refused(
            Reason.WRONG_DIGEST,
            f"{model.model} {model.version} of {model.block} has the digest {found}, but its header says "
            f"{model.digest}; it will be sent again",
        )
