"""`python -m services.actor --run NAME` (or `--run-dir DIR`) `[--index I]`: an actor of a run."""

import sys
from dataclasses import replace

from services.actor.index import add_options, index_of
from services.actor.service import SERVICE, Actor, build
from services.runtime.process import NO_FOLDER, Context, run_process
from services.runtime.settings import SettingsError


def build_numbered(context: Context) -> Actor:
    """The actor, with the index that it was told or found. Raises what `Actor` raises."""
    try:
        return build(replace(context, index=index_of(context)))
    except SettingsError as error:
        if context.run_dir == NO_FOLDER and context.settings.world.parameters.get("file"):
            raise SettingsError(
                f"{error}; only the settings of run {context.run} come over the network, so have the same "
                "file at the same path on this host"
            ) from None
        raise


if __name__ == "__main__":
    sys.exit(run_process(SERVICE, build_numbered, add_options=add_options, by_name=True))
