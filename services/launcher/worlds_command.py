"""`babble worlds`: what there is to live in."""

import argparse

from babble.worlds import WORLDS, WorldEntry, make


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble worlds`: none."""


def run(arguments: argparse.Namespace) -> int:
    """Print the worlds; returns 0."""
    print("\n\n".join("\n".join(world_lines(entry)) for entry in WORLDS.values()))
    return 0


def world_lines(entry: WorldEntry) -> list[str]:
    """A world, its parameters with their defaults, and its diameter with those."""
    world = make(entry.id, {}, columns=1, seed=0)
    parameters = ", ".join(f"{name} = {_toml(value)}" for name, value in entry.defaults.items())
    return [
        f"{entry.id}: {entry.description}",
        f"  parameters  {parameters}",
        f"  diameter    {entry.diameter} = {world.diameter:.4g}",
        f"  sizes       {world.observation_size} observed, {world.action_size} driven",
        f"  gymnasium   {entry.gymnasium_id}",
    ]


def _toml(value: object) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, tuple) else str(value)
