"""A NumPy generator's state as text, which every checkpoint format can hold."""

import json

import numpy as np


def dump(rng: np.random.Generator) -> str:
    """The state of a PCG64 generator."""
    return json.dumps(rng.bit_generator.state)


def load(rng: np.random.Generator, text: str) -> None:
    """Put a generator into a state that `dump` gave."""
    rng.bit_generator.state = json.loads(text)
