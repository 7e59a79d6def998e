"""Make the files of ``simcore/data/elimination``: in which order PARDISO eliminates the vertices of a grid.

    python scripts/elimination_order.py 51 61 101
    python scripts/elimination_order.py --skew 26 51 61 101

Minimum local fill (Tinney and Walker 1967, scheme 3): the vertex goes next whose elimination joins the fewest pairs of
its neighbours, the lower number of several. Then children of the elimination tree before their parents, which leaves
the fill as it is and brings together what is eliminated together. Minutes for 101.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from simcore.grid import OFFSETS, SKEW_OFFSETS

FOLDER = Path(__file__).resolve().parent.parent / "simcore" / "data" / "elimination"


def neighbours(side: int, skew: bool = False) -> list[int]:
    """Of each vertex of a square grid, the set of those that its Hessian couples it with, one bit a vertex."""
    offsets = OFFSETS[1:] + (SKEW_OFFSETS if skew else ())
    sets = [0] * (side * side)
    for row in range(side):
        for column in range(side):
            for down, right in offsets:
                other_row, other_column = row + down, column + right
                if other_row < side and 0 <= other_column < side:
                    a, b = row * side + column, other_row * side + other_column
                    sets[a] |= 1 << b
                    sets[b] |= 1 << a
    return sets


def members(bits: int) -> list[int]:
    """The numbers in a set."""
    found = []
    while bits:
        lowest = bits & -bits
        found.append(lowest.bit_length() - 1)
        bits ^= lowest
    return found


def fill(sets: list[int], vertex: int) -> int:
    """Pairs of a vertex's neighbours that are not neighbours yet."""
    own = members(sets[vertex])
    joined = sum((sets[other] & sets[vertex]).bit_count() for other in own)
    return (len(own) * (len(own) - 1) - joined) // 2


def least_fill(sets: list[int]) -> tuple[list[int], list[list[int]]]:
    """Vertices in the order of their elimination, and the neighbours that each had then; ``sets`` is used up."""
    scores = {vertex: fill(sets, vertex) for vertex in range(len(sets))}
    order, met = [], []
    while scores:
        vertex = min(scores, key=lambda v: (scores[v], v))
        del scores[vertex]
        own = sets[vertex]
        left = members(own)
        changed = own
        for other in left:
            apart = own & ~sets[other] & ~(1 << other)
            for third in members(apart):
                if third > other:
                    changed |= sets[other] & sets[third]  # these two are no missing pair of theirs any more
        for other in left:
            sets[other] = (sets[other] | own) & ~(1 << other) & ~(1 << vertex)
        sets[vertex] = 0
        for other in members(changed & ~(1 << vertex)):
            scores[other] = fill(sets, other)
        order.append(vertex)
        met.append(left)
    return order, met


def postordered(order: list[int], met: list[list[int]]) -> list[int]:
    """The same elimination with each vertex right after what is eliminated for it."""
    place = {vertex: number for number, vertex in enumerate(order)}
    children: dict[int, list[int]] = {vertex: [] for vertex in order}
    roots = []
    for vertex, left in zip(order, met, strict=True):
        if left:
            children[min(left, key=place.__getitem__)].append(vertex)
        else:
            roots.append(vertex)
    reverse, open_ = [], roots
    while open_:
        vertex = open_.pop()
        reverse.append(vertex)
        open_.extend(children[vertex])
    return reverse[::-1]


def main() -> None:
    """Write the files, of square grids."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sides", type=int, nargs="+", help="vertices along a side")
    parser.add_argument("--skew", action="store_true", help="for cloth whose bending is coupled with its twist")
    options = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    for side in options.sides:
        order = postordered(*least_fill(neighbours(side, options.skew)))
        name = f"{side}x{side}-skew.npy" if options.skew else f"{side}x{side}.npy"
        np.save(FOLDER / name, np.array(order, dtype=np.uint16))


if __name__ == "__main__":
    main()
