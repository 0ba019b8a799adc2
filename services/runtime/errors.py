"""The errors that a person can do something about: each text is one sentence, what, where, what to do."""


class UserError(Exception):
    """Shown as its one sentence, without a traceback; the process ends with code 2."""


class BusError(UserError):
    """The router cannot be reached, an address cannot be used, or the bus was closed."""


class RefusedError(BusError):
    """Whoever answers at the router's address will never let this process in; waiting does not help."""


class StorageError(UserError):
    """The disk refused a write or a read; nothing that was not written has been acknowledged."""


class SpoolError(UserError):
    """A spool file is damaged before its end, so acknowledged frames can no longer be read."""


class CheckpointError(UserError):
    """There are checkpoints, and none of them can be read, or gone on from."""
