"""What crosses the wire: messages, keys, codec, fingerprint and ledger (see SPEC.md)."""

PROTOCOL = 3
"""The protocol number in every frame; SPEC.md says when it is raised and why it was."""
