"""`Mode`: one submodel per finger as a code like ``00111``, little finger first, thumb last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb

from drake_hand.contact.submodel import Submodel
from drake_hand.errors import InputError
from drake_hand.model.html import html_table


@dataclass(frozen=True, order=True)
class Mode:
    """A vertex of the hybrid automaton: how each finger relates to the object (paper, Fig. 11)."""

    submodels: tuple[Submodel, ...]
    """In the hand's order, little finger first, thumb last."""

    @classmethod
    def parse(cls, code: str, fingers: Sequence[str], *, key: str | None = None) -> Mode:
        """Reads a mode code.

        Args:
            code: a digit 0 (free), 1 (rolling) or 2 (sliding) per finger.
            fingers: names of the hand's fingers, in its order.
            key: of the code in its file, for the error.

        Raises:
            InputError: wrong length or a wrong digit.
        """
        expected = f"{len(fingers)} digits 0 (free), 1 (rolling) or 2 (sliding): {', '.join(fingers)}"
        wrong = [i for i, digit in enumerate(code) if digit not in "012"]
        if wrong:
            place = wrong[0] + 1
            message = f"mode code '{code}' has '{code[wrong[0]]}' at place {place}"
            raise InputError(message, key=key, found=code, expected=expected)
        if len(code) != len(fingers):
            message = f"mode code '{code}' has {len(code)} digits for a hand of {len(fingers)} fingers"
            raise InputError(message, key=key, found=code, expected=expected)
        return cls(tuple(Submodel(int(digit)) for digit in code))

    @property
    def code(self) -> str:
        """The code, ``00111``."""
        return "".join(str(int(s)) for s in self.submodels)

    @property
    def touching(self) -> tuple[int, ...]:
        """Indices of the fingers in contact."""
        return tuple(i for i, s in enumerate(self.submodels) if s.touches)

    @property
    def free(self) -> tuple[int, ...]:
        """Indices of the free fingers."""
        return tuple(i for i, s in enumerate(self.submodels) if not s.touches)

    def replace(self, finger: int, submodel: Submodel) -> Mode:
        """The mode in which one finger has another submodel."""
        return Mode((*self.submodels[:finger], submodel, *self.submodels[finger + 1 :]))

    def words(self, fingers: Sequence[str]) -> str:
        """The mode in words: ``little and ring free; middle, index and thumb rolling``."""
        groups = []
        for submodel in Submodel:
            names = [name for name, s in zip(fingers, self.submodels, strict=True) if s is submodel]
            if names:
                groups.append(f"{listed(names)} {submodel.word}")
        return "; ".join(groups)

    def __str__(self) -> str:
        return self.code

    def _repr_html_(self) -> str:
        n = len(self.submodels)
        rows = [(n - i, s.word, s.constraint) for i, s in enumerate(self.submodels)]
        columns = ["finger, from the thumb", "submodel", "what it constrains"]
        return html_table(f"mode {self.code}", columns, reversed(rows))


def all_modes(n: int) -> Iterator[Mode]:
    """All 3^n modes of a hand of n fingers in the order of their codes, one by one."""
    return (Mode(submodels) for submodels in product(Submodel, repeat=n))


def contact_counts(n: int) -> list[int]:
    """Number of modes with 0, 1, ... n fingers in contact: 1, 10, 40, 80, 80, 32 for five (paper, Fig. 11)."""
    return [comb(n, k) * 2**k for k in range(n + 1)]


def listed(names: Sequence[str]) -> str:
    """Names as in a sentence: ``middle, index and thumb``."""
    return " and ".join([*([", ".join(names[:-1])] if names[:-1] else []), *names[-1:]])
