"""A command line that is refused in one line, for terminals and for the logs of containers."""

import argparse
from typing import NoReturn


class OneLineParser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the whole usage before it; the exit code is 2."""

    def error(self, message: str) -> NoReturn:
        """See `argparse.ArgumentParser.error`."""
        self.exit(2, f"{self.prog}: {message}; see `{self.prog} --help`\n")
