"""Greedy k-centre (Gonzalez 1985): each row that is chosen is as far as possible from those before."""

import numpy as np

from babble.coverage_passes import Doubles, Floats, squared_distances

BLOCK_ROWS = 4096


def insertion_distances(states: Floats, middle: Floats, centres: int) -> Doubles:
    """(centres - 1,) distances of each new centre to the nearest before it, never growing.

    The first centre is the row nearest to `middle` (s,); the mean makes the distances independent of
    the order of the rows. After j centres every row is within the j-th distance of one of them, and no
    choice of j centres does better than half of it. Fewer distinct rows than centres end in zeros.

    Exact, but most rows are never compared with most centres: a row's distance to the first centre is
    an upper bound of its distance to the nearest, so only rows whose bound reaches the largest
    distance found are looked at. Raises ValueError for fewer than two centres.
    """
    if centres < 2:
        raise ValueError(f"greedy k-centre needs two or more centres, got {centres}")
    start = states[int(squared_distances(states, middle).argmin())]
    bound = squared_distances(states, start)
    order = np.argsort(-bound, kind="stable")
    near = bound[order]
    known, found = 0, np.zeros(centres - 1)
    chosen: list[Floats] = []
    for k in range(centres - 1):
        while known < len(near) and (known == 0 or near[:known].max() < near[known]):
            block = slice(known, min(len(near), known + max(BLOCK_ROWS, known // 2)))
            for centre in chosen:
                near[block] = np.minimum(near[block], squared_distances(states, centre, order[block]))
            known = block.stop
        at = int(near[:known].argmax())
        found[k] = np.sqrt(np.float64(near[at]))
        chosen.append(states[order[at]])
        near[:known] = np.minimum(near[:known], squared_distances(states, chosen[-1], order[:known]))
    return found
