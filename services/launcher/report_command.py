"""`babble report RUN`: the report, the figures and the table of numbers anew, of any run at any time."""

import argparse

from services.launcher.run_folder import RunFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble report`."""
    parser.add_argument("run", metavar="RUN", help="a run folder, or the name of one under runs/")
    parser.add_argument(
        "--tensorboard", action="store_true", help="write event files for TensorBoard too, in tensorboard/"
    )
    parser.add_argument(
        "--no-rollouts",
        action="store_true",
        help="do not roll the saved models out: quicker, without the figures of where goals lead",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write everything anew; returns 0. Raises `UserError` if there is no such run or the disk refuses."""
    from services.launcher.report import write_report

    folder = RunFolder.find(arguments.run)
    path = write_report(folder.path, rollouts=not arguments.no_rollouts)
    print(f"wrote {folder.shown}/{path.name}", flush=True)
    if arguments.tensorboard:
        from services.launcher.tensorboard_events import write_events

        events = write_events(folder.path)
        print(f"wrote {folder.shown}/{events.name}/; see it with: tensorboard --logdir {folder.shown}")
    return 0
