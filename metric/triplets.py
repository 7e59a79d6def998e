"""Triplets of the human study: which of two fabrics drapes more like a reference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simcore.errors import InputError

TRIPLETS_A_PARTICIPANT = 20
TIMES_AS_REFERENCE = 2
LEAST_FABRICS = 4
"""Of three fabrics there are three questions, and each would have to be the reference twice."""


@dataclass(frozen=True, order=True)
class Triplet:
    """One question; fabrics by their place in the study's list.

    Attributes:
        reference: the fabric to compare with.
        left, right: the two to choose from, as shown.
    """

    reference: int
    left: int
    right: int

    @property
    def question(self) -> tuple[int, int, int]:
        """The same whichever side a fabric is shown on."""
        return (self.reference, min(self.left, self.right), max(self.left, self.right))


@dataclass(frozen=True)
class Answer:
    """One answered triplet.

    Attributes:
        participant: who.
        triplet: the question.
        chosen: the fabric chosen, ``left`` or ``right`` of the triplet.
        simulated: given by a simulated observer, not by a person.
    """

    participant: str
    triplet: Triplet
    chosen: int
    simulated: bool = False

    def __post_init__(self) -> None:
        if self.chosen not in (self.triplet.left, self.triplet.right):
            raise InputError(
                f"the answer {self.chosen} is neither of the two fabrics {self.triplet.left} and {self.triplet.right}",
                code="answer_not_offered",
            )

    @property
    def rejected(self) -> int:
        """The fabric not chosen."""
        return self.triplet.right if self.chosen == self.triplet.left else self.triplet.left


def draw_triplets(
    fabrics: int, rng: np.random.Generator, *, count: int = TRIPLETS_A_PARTICIPANT, shared: Sequence[Triplet] = ()
) -> list[Triplet]:
    """A participant's questions: pseudo-random, no question twice, each fabric at least twice as reference where
    ``count`` allows, and no fabric much more often than another.

    Args:
        fabrics: number of fabrics, at least 4.
        rng: random numbers of this participant.
        count: questions.
        shared: questions put to everybody, so that agreement can be measured; part of ``count``.

    Raises:
        InputError: too few fabrics, too few different questions, or too few to have each fabric as reference twice.
    """
    check_plan(fabrics, count)
    if len(shared) > count:
        raise InputError(f"{len(shared)} shared triplets do not fit into {count}", code="triplets_shared")
    chosen = {t.question for t in shared}
    as_reference = Counter(t.reference for t in shared)
    shown = Counter(f for t in shared for f in (t.left, t.right))
    while len(chosen) < count:
        question = _next_question(fabrics, chosen, as_reference, shown, rng)
        chosen.add(question)
        as_reference[question[0]] += 1
        shown.update(question[1:])
    order = rng.permutation(sorted(chosen))
    flips = rng.random(count) < 0.5
    return [Triplet(int(r), int(b if f else a), int(a if f else b)) for (r, a, b), f in zip(order, flips, strict=True)]


def shared_triplets(fabrics: int, rng: np.random.Generator, count: int) -> list[Triplet]:
    """Questions for everybody, each with another reference as far as possible."""
    if count == 0:
        return []
    references = [int(r) for r in np.concatenate([rng.permutation(fabrics) for _ in range(-(-count // fabrics))])]
    found: dict[tuple[int, int, int], Triplet] = {}
    for reference in references[:count]:
        while True:
            left, right = (int(i) for i in rng.choice([i for i in range(fabrics) if i != reference], 2, replace=False))
            triplet = Triplet(reference, left, right)
            if triplet.question not in found:
                found[triplet.question] = triplet
                break
    return list(found.values())


def check_plan(fabrics: int, count: int) -> None:
    """Whether a participant can be asked so many questions about so many fabrics.

    Raises:
        InputError: they cannot.
    """
    if fabrics < LEAST_FABRICS:
        raise InputError(
            f"a triplet study needs at least {LEAST_FABRICS} fabrics, got {fabrics}: with fewer there are not enough "
            f"questions for each to be the reference {TIMES_AS_REFERENCE} times",
            code="fabrics_too_few",
        )
    questions = fabrics * (fabrics - 1) * (fabrics - 2) // 2
    if count > questions:
        raise InputError(
            f"{fabrics} fabrics allow {questions} different triplets, not {count}: ask for fewer", code="triplets_many"
        )
    if count < TIMES_AS_REFERENCE * fabrics:
        raise InputError(
            f"{count} triplets cannot have each of {fabrics} fabrics as reference {TIMES_AS_REFERENCE} times: "
            f"ask at least {TIMES_AS_REFERENCE * fabrics}, or take fewer fabrics",
            code="triplets_few",
        )


def _next_question(
    fabrics: int,
    chosen: set[tuple[int, int, int]],
    as_reference: Counter[int],
    shown: Counter[int],
    rng: np.random.Generator,
) -> tuple[int, int, int]:
    """A question not yet chosen: the reference used least so far, candidates shown least, ties at random."""
    tie = rng.random(fabrics)
    for reference in sorted(range(fabrics), key=lambda i: (as_reference[i], tie[i])):
        others = [i for i in range(fabrics) if i != reference]
        pairs = [(a, b) for k, a in enumerate(others) for b in others[k + 1 :] if (reference, a, b) not in chosen]
        if pairs:
            noise = rng.random(len(pairs))
            first, second = pairs[
                min(range(len(pairs)), key=lambda k: (sum(shown[i] for i in pairs[k]) // 2, noise[k]))
            ]
            return (reference, first, second)
    raise AssertionError("check_plan leaves a question")
