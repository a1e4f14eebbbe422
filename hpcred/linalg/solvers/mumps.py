"""Factor by MUMPS, through PETSc: its controls, its estimates before a factor is made, and its codes of failure.

No other module knows how MUMPS is told what to do, or what it tells.
"""

from __future__ import annotations

import ctypes
import os
import re

import numpy as np

from ...parallel import startup
from ...parallel.failures import ComputationError, InputError, agreed
from ...parallel.memory import MB
from ...parallel.petsc import PETSc, is_complex
from ..known import EXACT, Source
from ..options import temporary_options
from .base import DoesNotFit, SingularMatrix
from .petsc import PetscFactorisation
from .settings import Factoring

MORE_ROOM = (-8, -9, -14, -15, -17, -20)  # INFOG(1): a workspace was too small
NO_FILE = -90  # out of core
LONGEST_FOLDER = 255  # bytes of a name that MUMPS takes; it cuts longer ones, and writes elsewhere or fails
OUT_OF_MEMORY = (-7, -13, -19)
SINGLE_SINCE = (3, 25)  # PETSc's -pc_precision
SOLVE_WIDTH = 96  # columns that MUMPS solves for at a time; wider ones take memory (`hpcred bench` compares widths)
WIDTH_OPTION = "mat_mumps_icntl_27"  # of that
ANALYSIS = {"icntl_23": 1}  # a limit of 1 MB, at which all but tiny matrices are only analysed
CHOOSE_ABOVE = 10_000  # rows from which on an ordering is worth a second analysis
ORDERINGS = {0: "AMD", 2: "AMF", 3: "SCOTCH", 4: "PORD", 5: "METIS", 6: "QAMD"}
SCOTCH, PORD, METIS = 3, 4, 5  # icntl_7; PORD is in every MUMPS, which takes it where it was built without the others


class Mumps(PetscFactorisation):
    """Factors by MUMPS. `settings`: controls such as {"icntl_13": 1}, which users' own options override."""

    name = "mumps"
    tells_inertia = True
    has_single = True

    def __init__(self, matrix, symmetric, prefix, factoring: Factoring | None = None, reserved_mb=0.0, inertia=False,
                 null_pivots=False, settings: dict | None = None):  # fmt: skip
        super().__init__(matrix, symmetric, prefix, factoring, inertia=inertia)
        self._ksp.setErrorIfNotConverged(False)  # for codes of MUMPS say more
        self._chosen = False
        self._under_way: PETSc.Mat | None = None  # the factor that is being made
        if self.factoring.single:
            _check_single()
        with agreed(matrix.comm.tompi4py()):  # the folder may be on a disk of each node
            self.factoring.make_folder()
        # icntl_13: without ScaLAPACK, whose root is not counted, MUMPS splits the root over the ranks; -1 would do both
        self._settings = {
            "icntl_7": nested_dissection(), "icntl_14": 40, "icntl_27": SOLVE_WIDTH, **controls(self.factoring),
            **({"icntl_13": 1} if inertia else {}), **({"icntl_24": 1} if null_pivots else {}), **(settings or {}),
        }  # fmt: skip
        # before the first factor takes its part
        self._limit = max(self.factoring.limit_mb(matrix.comm.tompi4py()) - int(reserved_mb), 1)

    @classmethod
    def check(cls, factoring):
        folder = factoring.out_of_core
        if folder is not None and len(os.fsencode(folder)) > LONGEST_FOLDER:
            raise InputError(
                f"out_of_core: the name of the folder has {len(os.fsencode(folder))} bytes, MUMPS takes "
                f"{LONGEST_FOLDER}; name another: {folder}"
            )

    @classmethod
    def source_of(cls, factoring, prefix):
        """See Factorisation; options of users count too."""
        options = PETSc.Options(prefix)
        low_rank = options.getInt("mat_mumps_icntl_35", int(factoring.low_rank is not None))
        accuracy = options.getReal("mat_mumps_cntl_7", factoring.low_rank or 0.0) if low_rank else 0.0
        if factoring.single or options.getString("pc_precision", "double") == "single":
            accuracy = max(accuracy, float(np.finfo(np.float32).eps))
        return Source(kind="approximate factor", accuracy=accuracy) if accuracy else EXACT

    @classmethod
    def slicing(cls, factoring, comm):
        if factoring.single:  # whose solutions have to be refined
            return None
        settings = {"icntl_13": 1, "icntl_24": 1, "cntl_3": 1e-12, "icntl_7": nested_dissection(), "icntl_14": 60}
        settings |= _on_disk(factoring)  # low rank is for solutions that are refined
        return {"pc_factor_mat_solver_type": cls.name} | {f"mat_mumps_{key}": value for key, value in settings.items()}

    def expected(self, orderings) -> dict[int, dict]:
        """What a factor with each of the orderings (icntl_7) takes, as MUMPS estimates by analyses alone: `flops`,
        `entries`, `mb` in all and `mb_max_rank`, and `mb_on_disk`, those in all where factors are on a disk."""
        reports = {}
        for ordering in orderings:
            mumps = self._set_up(ANALYSIS | {"icntl_7": ordering})
            reports[ordering] = {
                "flops": mumps.getMumpsRinfog(1), "entries": _entries(mumps.getMumpsInfog(20)),
                "mb": mumps.getMumpsInfog(17), "mb_max_rank": mumps.getMumpsInfog(16),
                "mb_on_disk": mumps.getMumpsInfog(27),
            }  # fmt: skip
            self.release()
        return reports

    def _choose_ordering(self):
        """Once, where MUMPS has several nested dissections and the user chose none, nor a parallel analysis (icntl_28),
        whose orderings are others: that of the fewest operations."""
        if self._chosen:
            return
        self._chosen = True
        theirs = any(PETSc.Options(self.prefix).hasName(f"mat_mumps_icntl_{number}") for number in (7, 28))
        available = orderings()
        if len(available) > 1 and not theirs and self.matrix.getSize()[0] >= CHOOSE_ABOVE:
            reports = self.expected(available)
            flops = {key: report["flops"] for key, report in reports.items() if report["flops"] > 0}  # 0: it failed
            self._settings["icntl_7"] = min(flops, key=flops.get, default=self._settings["icntl_7"])

    def estimate(self):
        """See Solver; by an analysis alone."""
        self._choose_ordering()
        mumps = self._set_up(ANALYSIS)
        on_disk = self.factoring.out_of_core is not None
        total, largest = (mumps.getMumpsInfog(i) for i in ((27, 26) if on_disk else (17, 16)))
        message = self._does_not_fit(mumps)
        self.release()
        if largest > self._limit:
            raise DoesNotFit(message)
        return total, self._limit * self.matrix.comm.size

    def _does_not_fit(self, mumps):
        rank, total, on_disk = (mumps.getMumpsInfog(i) for i in (16, 17, 26))
        return (
            f"the factorisation does not fit: it needs about {rank} MB on one rank and {total} MB in all, and a rank "
            f"has {self._limit} MB; take more ranks on more nodes, fewer groups, or keep factors on a disk "
            f"(out_of_core: about {on_disk} MB a rank)"
        )

    def _set_up(self, forced=None, **more):
        """What MUMPS makes by the settings and `more`, which users' options override, and by what is `forced`."""
        precision = {"pc_precision": "single"} if self.factoring.single else {}
        with (
            temporary_options(self.prefix + "mat_mumps_", self._settings | more, forced),
            temporary_options(self.prefix, {}, precision),
        ):
            pc = self._ksp.getPC()
            self._ksp.setOperators(self.matrix)
            pc.setFactorSetUpSolverType()
            self._under_way = pc.getFactorMatrix()
            self._under_way.setOptionsPrefix(self.prefix)  # which the set-up gives only to those that it makes
            try:
                return super()._set_up()
            finally:
                self._under_way = None

    def known(self):
        """See Solver: operations by the analysis, and seconds at the pace of the factor before."""
        factor = self._under_way
        operations = 0.0 if factor is None else factor.getMumpsRinfog(1)
        if not operations > 0:
            return "", None
        before = next((record for record in reversed(self.records) if record.flops), None)
        return f"{operations:.1e} operations", before and before.factor_seconds * operations / before.flops

    def _made(self):
        self._choose_ordering()
        # MUMPS compares its estimate with this limit after the analysis; then it asks the system for all of it at once
        limit = 0 if self._is_small() else self._limit
        room = PETSc.Options(self.prefix).getInt("mat_mumps_icntl_14", self._settings["icntl_14"])
        for retries in range(5):
            more = {"icntl_14": max(room, 25) * 2**retries} if retries else {}
            mumps = self._set_up(more, icntl_23=limit)
            code, detail = mumps.getMumpsInfog(1), mumps.getMumpsInfog(2)
            if code >= 0:
                return {"workspace_retries": retries, **self._told(mumps)}
            message = self._does_not_fit(mumps)
            self.release()  # a failed factor cannot be used again
            if code == -10:
                raise SingularMatrix()
            if code in OUT_OF_MEMORY:
                raise DoesNotFit(message)
            if code == NO_FILE:
                raise ComputationError(f"out_of_core: MUMPS cannot write factors to {self.factoring.out_of_core}; "
                                       "make room there, or name another folder")  # fmt: skip
            if code not in MORE_ROOM:
                raise ComputationError(f"MUMPS failed to factor: INFOG(1) = {code}, INFOG(2) = {detail}")
        raise ComputationError(f"MUMPS wants ever more workspace: INFOG(1) = {code}, INFOG(2) = {detail}")

    def _told(self, factor):
        return {
            "ordering": ORDERINGS.get(factor.getMumpsInfog(7), "other"),
            "factor_entries": _entries(factor.getMumpsInfog(29)),
            "flops": factor.getMumpsRinfog(3),
            "memory_mb_estimated_total": factor.getMumpsInfog(17),
            "memory_mb_estimated_max_rank": factor.getMumpsInfog(16),
            "memory_mb_used_max_rank": factor.getMumpsInfog(21),
            "memory_mb_used_total": factor.getMumpsInfog(22),
            "negative_pivots": factor.getMumpsInfog(12),
            "null_pivots": factor.getMumpsInfog(28),
        }

    def _is_small(self):
        """Whether a factor would fit even if it had ten times the entries that nested dissection of a solid gives."""
        rows = self.matrix.getSize()[0]
        entries = min(rows * rows, 3 * self.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] * rows ** (1 / 3))
        return entries * np.dtype(PETSc.ScalarType).itemsize <= self._limit * MB

    def set_solve_width(self, columns: int):
        """How many columns MUMPS solves for at a time with the present factor, for measurements."""
        self._ksp.getPC().getFactorMatrix().setMumpsIcntl(27, columns)


def _entries(count):
    """A count of MUMPS, which is negative and in millions where it is too large."""
    return count if count >= 0 else -count * 10**6


def nested_dissection() -> int:
    """The ordering (icntl_7) that is taken where the user chose none."""
    return SCOTCH if startup.with_scotch else METIS


def orderings() -> tuple[int, ...]:
    """The nested dissections (icntl_7) that the MUMPS that is loaded was built with."""
    symbols = {SCOTCH: "mumps_scotch_", METIS: "mumps_metis_kway_"}
    return tuple(number for number, name in symbols.items() if _function(name) is not None)


def controls(factoring: Factoring) -> dict:
    """What settings mean to MUMPS, once PETSc is loaded. Raises InputError where it cannot do it."""
    settings = _on_disk(factoring)
    if factoring.low_rank is not None:
        _check_low_rank()
        settings |= {"icntl_35": 2, "cntl_7": factoring.low_rank}
    return settings


def _on_disk(factoring):
    return {} if factoring.out_of_core is None else {"icntl_22": 1, "ooc_tmpdir": factoring.out_of_core}


def _check_low_rank():
    """Raise InputError where block low rank factors of the MUMPS that is loaded would end in a crash.

    The rows of a front are grouped by METIS, or by Scotch where MUMPS was built without METIS; MUMPS before 5.6 hands
    Scotch a graph that was not initialised.
    """
    if _function("mumps_scotch_") is None or _function("mumps_metis_kway_") is not None:
        return
    version = ctypes.create_string_buffer(32)
    _function("mumps_set_version_")(version, ctypes.c_size_t(len(version)))
    version = version.raw.decode().strip(" \0")
    if [int(number) for number in re.findall(r"\d+", version)] < [5, 6]:
        plain = "set HPCRED_SCOTCH=0 in the environment, or " if startup.with_scotch else ""
        raise InputError(
            f"low_rank: MUMPS {version} with Scotch crashes there; {plain}take MUMPS 5.6 or later, or one with METIS"
        )


def _check_single():
    """Raise InputError where PETSc cannot have MUMPS factor in single precision."""
    version = PETSc.Sys.getVersion()
    if version < SINGLE_SINCE:
        raise InputError(
            f"solver.precision: 'single' needs PETSc {'.'.join(map(str, SINGLE_SINCE))} or later, found "
            f"{'.'.join(map(str, version))}; leave it out, or take another PETSc"
        )
    if _function("cmumps_c" if is_complex() else "smumps_c") is None:
        raise InputError(
            "solver.precision: this PETSc has a MUMPS without single precision; leave it out, or take another PETSc"
        )


def _function(name):
    """A function of the MUMPS that is loaded, or None; looked up where the loader does, global libraries first."""
    for library in (ctypes.CDLL(None), ctypes.CDLL(PETSc.__file__)):
        if hasattr(library, name):
            return getattr(library, name)
    return None
