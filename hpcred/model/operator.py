"""Hold what acts on displacements as one operator, A(s) = sum_k c_k(s) A_k: matrices, and laws of their coefficients.

Mass, damping and stiffness are the terms M, D and K with s^2, s and 1. Beside them stand added terms, whose law is of
any kind of hpcred.model.laws; K is then the static stiffness, and their coefficients are 0 at s = 0. Matrices are PETSc
matrices, or small NumPy arrays of projected models. Whoever transforms a model maps its operator, and lists no terms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..linalg.eigensolver import congruent

ADDED = "viscoelastic"  # key of added terms in files, records and digests, after the kind that was the first
KEY = "Kv"  # of the matrices of added terms: Kv1, Kv2, ...
ORDERS = {"M": 2, "D": 1, "K": 0}  # powers of s


class Law(ABC):
    """The coefficient c(s) of a term, an open family: each kind is a frozen dataclass with a field `kind`.

    `family`: what its terms are called in reports and messages; `nature`: the word for laws without states;
    `power`: c depends on s^power near s = 0, where a grid of frequencies has to follow it, 0 where it does not;
    `static`: the multiple of the matrix in the static stiffness.
    """

    family = "added"
    nature = "no sum of Maxwell elements"
    power = 1.0
    static = 0.0

    @abstractmethod
    def coefficient(self, s: np.ndarray) -> np.ndarray:
        """Return c(s) at s (...) in 1/s, complex; c(s*) = c(s)*."""

    @abstractmethod
    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of c at s (...) in 1/s, for Newton's method."""

    @abstractmethod
    def in_units(self, time: float) -> Law:
        """Return the law in a unit of time of `time` seconds."""

    @property
    def elements(self) -> tuple[tuple[float, float], ...] | None:
        """Factor and time of the Maxwell elements factor s time / (1 + s time) that c is the sum of, None of others."""
        return None


@dataclass(frozen=True)
class Power(Law):
    """s^order, the law of mass, damping and stiffness."""

    order: int

    def coefficient(self, s):
        s = np.asarray(s, dtype=complex)
        return np.prod([s] * self.order, axis=0) if self.order else np.ones_like(s)

    def slope(self, s):
        return self.order * Power(max(self.order - 1, 0)).coefficient(s)

    def in_units(self, time):
        return self


@dataclass(frozen=True, eq=False)
class Term:
    """A matrix with the law of its coefficient, and its name in messages and records."""

    matrix: Any
    law: Law
    name: str = ""

    @property
    def in_words(self) -> str:
        """Name and law."""
        return f"{self.name}: {self.law!r}"


@dataclass(frozen=True, eq=False)
class Operator:
    """A(s) = sum_k c_k(s) A_k, with its terms by key: M, D, K, and Kv1, Kv2, ... of added ones.

    Iterating gives the terms; an operator without terms is false. Nothing of it changes: the methods return others.
    """

    terms: Mapping[str, Term]

    @classmethod
    def of(cls, M=None, D=None, K=None, added: Iterable[Term] = ()) -> Operator:
        """Return the operator of M, D, K, each a matrix or None, and of added terms."""
        main = {
            key: Term(mat, Power(ORDERS[key]), key) for key, mat in (("M", M), ("K", K), ("D", D)) if mat is not None
        }
        return cls(main | {f"{KEY}{number}": term for number, term in enumerate(added, 1)})

    def __iter__(self) -> Iterator[Term]:
        return iter(self.terms.values())

    def __len__(self) -> int:
        return len(self.terms)

    def __getitem__(self, key: str):
        return self.terms[key].matrix

    def get(self, key: str):
        """Return the matrix of a term, None where there is no such term."""
        return self.terms[key].matrix if key in self.terms else None

    @property
    def matrices(self) -> dict:
        """The matrices by key."""
        return {key: term.matrix for key, term in self.terms.items()}

    @property
    def added(self) -> Operator:
        """The terms beside M, D and K."""
        return Operator({key: term for key, term in self.terms.items() if key not in ORDERS})

    @property
    def quadratic(self) -> Operator:
        """M, D and K alone."""
        return Operator({key: term for key, term in self.terms.items() if key in ORDERS})

    @property
    def plural(self) -> str:
        """What added terms are called in messages, such as "viscoelastic parts"."""
        return " and ".join(f"{family} parts" for family in self.families)

    @property
    def names(self) -> str:
        """The names of the terms, for messages."""
        return ", ".join(term.name for term in self)

    @property
    def families(self) -> dict[str, list[str]]:
        """Names and laws of added terms in words, by what they are called."""
        words: dict[str, list[str]] = {}
        for term in self.added:
            words.setdefault(term.law.family, []).append(term.in_words)
        return words

    def map(self, function: Callable) -> Operator:
        """Return the same terms with function(matrix) for each matrix."""
        return Operator({key: replace(term, matrix=function(term.matrix)) for key, term in self.terms.items()})

    def with_matrices(self, matrices: Mapping) -> Operator:
        """Return the operator with these matrices by key: all of the added terms, and M, D, K where there is one."""
        added = [replace(term, matrix=matrices[key]) for key, term in self.added.terms.items()]
        return self.of(*map(matrices.get, "MDK"), added)

    def where(self, condition: Callable[[Law], bool]) -> Operator:
        """Return the terms whose law meets a condition."""
        return Operator({key: term for key, term in self.terms.items() if condition(term.law)})

    def with_laws(self, function: Callable[[Law], Law]) -> Operator:
        """Return the same terms with function(law) for each law."""
        return Operator({key: replace(term, law=function(term.law)) for key, term in self.terms.items()})

    def projected(self, T: np.ndarray) -> Operator:
        """Return T^T A T of small matrices, exactly symmetric where they are."""
        return self.map(lambda matrix: congruent(matrix, T))

    def coefficients(self, s) -> np.ndarray:
        """Return c_k (terms, ...) at s (...) in 1/s."""
        s = np.asarray(s, dtype=complex)
        return np.array([term.law.coefficient(s) for term in self]).reshape(len(self), *s.shape)

    def slopes(self, s) -> np.ndarray:
        """Return the derivatives of c_k (terms, ...) at s (...)."""
        s = np.asarray(s, dtype=complex)
        return np.array([term.law.slope(s) for term in self]).reshape(len(self), *s.shape)

    def summed(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the sum (..., m, m) of coefficients (terms, ...) times small matrices."""
        return np.tensordot(np.moveaxis(coefficients, 0, -1), np.array([term.matrix for term in self]), axes=1)

    def at(self, s) -> np.ndarray:
        """Return A(s) (..., m, m) of small matrices at s (...) in 1/s."""
        return self.summed(self.coefficients(s))

    def apply(self, s: np.ndarray, states: np.ndarray, transposed=False) -> np.ndarray:
        """Return A(s) x (S, m, l), or A(s)^T x, of small matrices for s (S,) and x (S, m, l)."""
        matrices = (term.matrix.T if transposed else term.matrix for term in self)
        return sum(factor[:, None, None] * times(matrix, states)
                   for factor, matrix in zip(self.coefficients(s), matrices, strict=True))  # fmt: skip

    def digest(self, digest_of: Callable) -> list:
        """Return plain data that tells the laws, and by digest_of(key) the matrices, from others."""
        laws = [{"name": term.name, "law": asdict(term.law)} for term in self]  # type: ignore[call-overload]
        return [laws, [digest_of(key) for key in self.terms]]


NOTHING = Operator({})


def in_coordinates(of: str, matrix: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return M, D, K, B, C, Cv or Ca, as `of` tells, in coordinates z with x = T z."""
    rows = matrix if of.startswith("C") else T.T @ matrix
    return rows if of == "B" else rows @ T


def times(matrix: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return matrix (m, k) states (S, k, l), as one product."""
    count, size, width = states.shape
    flat = np.ascontiguousarray(states.transpose(1, 0, 2)).reshape(size, count * width)
    if np.isrealobj(matrix) and np.iscomplexobj(flat):
        flat = (np.ascontiguousarray(matrix) @ flat.view(float)).view(complex)
    else:
        flat = matrix @ flat
    return flat.reshape(len(matrix), count, width).transpose(1, 0, 2)
