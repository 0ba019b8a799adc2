"""How many places a run visited, in bits, over a grid that is the same for every run."""

import numpy as np

from babble.coverage_passes import Floats, chunks, unit_directions

CELL_WIDTH = 1.0
"""Of a cell along each of its directions, in the unit of the states (rad and rad/s)."""
GRIDS = 8
DIRECTIONS_PER_GRID = 3
GRID_SEED = 45
"""Of the directions; never the seed of a run, or two runs would not compare."""
MOST_CELLS_ALONG = 1 << 20


def visited_cells_entropy(states: Floats, width: float = CELL_WIDTH) -> float:
    """The Shannon entropy in bits of the cell in which a row of (N, s) lies; the mean over GRIDS grids.

    A grid is three fixed directions drawn evenly from the sphere, cut at whole multiples of `width`.
    It depends on s alone, not on the data: 0 = one cell, log2(N) = each row in a cell of its own.
    Raises ValueError for a width so small that a direction has more than a million cells.
    """
    dims = states.shape[1]
    directions = unit_directions(GRIDS * DIRECTIONS_PER_GRID, dims, GRID_SEED)
    return float(np.mean([_entropy(states, three, width) for three in np.split(directions, GRIDS)]))


def _entropy(states: Floats, directions: Floats, width: float) -> float:
    cell = np.empty(len(states), np.int64)
    for rows in chunks(len(states)):
        places = np.floor(states[rows] @ directions.T / width)
        if np.abs(places).max() >= MOST_CELLS_ALONG // 2:
            raise ValueError(f"cells of width {width} are too small for states as large as these")
        along = places.astype(np.int64) + MOST_CELLS_ALONG // 2
        cell[rows] = (along[:, 0] * MOST_CELLS_ALONG + along[:, 1]) * MOST_CELLS_ALONG + along[:, 2]
    cell.sort()
    edges = np.flatnonzero(np.diff(cell)) + 1
    visits = np.diff(np.concatenate([[0], edges, [len(cell)]]))
    shares = visits / len(cell)
    return float(-(shares * np.log2(shares)).sum())
