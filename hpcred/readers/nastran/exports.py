"""Read exports of Nastran, OptiStruct and MYSTRAN, a file with its companions, to the parts of a model.

The matrices are in OP4, in OP2 or on DMIG cards. The dofs of their rows and the nodes come from an OP2 of the same name
beside them (USET, BGPDT), or from the input file. Rows in displacement systems of the nodes (CD) are rotated to
x, y, z.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...fe.dofs import OWN, SCALAR
from ...files.system_errors import damaged_file
from ...files.text import first_bytes, open_unpacked
from ...parallel.decisions import decided
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import look_up, number_over_ranks
from ..base import Reader
from ..entries import STRIDE, Entries, LabelledEntries, asymmetry, label_name, label_of
from ..nodal_systems import turned_entries
from ..nodes.table import NodeTable
from ..parts import Parts, common_size, labels_in_order
from . import bulk, dmig, op2, op4
from .bulk import beside
from .names import STRUCTURAL, Choice, letter_of, named, none_found, pairs
from .points import HELD, SETS, Points, present, refined, turn_of
from .sets import hold_rotations_of_solids, mark_sets

NO_USET = (
    "put the OP2 of the run (tables BGPDT and USET) or the input file of the same name beside it; without nodes there "
    "are no rigid-body modes, pictures or exports"
)
SYMMETRIC_IN_FILE = 1e-8  # ||A - A^T|| / ||A||, for the digits that files have
LOOSE = (
    "matrices of the G-set have no supports (SPC) and no rigid elements or constraints (RBE, MPC) applied: what these "
    "join is loose; export {} to have them"
)
WEIGHT = re.compile(rb"MASS AXIS SYSTEM \(S\)[^\n]*\n[ \t]*X[ \t]+(?P<mass>[-+\d.]+E[-+]\d+)")  # of GRDPNT in an .f06
LONGEST = 2**30  # bytes of a listing that is looked at
SAME = 0.01


@dataclass
class _Rows:
    """The known rows of matrices: `points` and `mask` (points, 6) of the dofs that have rows, in order."""

    points: Points
    mask: np.ndarray
    source: Path
    deck: bulk.Deck | None  # with the elements


def begins_bulk(start: bytes) -> bool:
    """Test whether a text that starts so is a punch file with matrices, or an input file with them beside it."""
    return dmig.begins(start) or bulk.begins(start)


def read_op4(path, comm, variables=None) -> Parts:
    """Return the model of an OP4 file, or of an OP2 with matrices; `variables`: names by K, M, D. Collective."""
    path = Path(path)
    files, contents = _op4_files(path, comm)
    names = [matrix.name for matrix in contents]
    se = _superelements(files, contents, comm)
    choices = _choices(path, names, se, variables)
    rows, choice, warnings = _rows_of(path, comm, [(some, contents[some.places["K"]].shape[0], se[some.places["K"]])
                                                   for some in choices], bool(variables))  # fmt: skip
    files = {key: files[place] for key, place in choice.places.items()}
    taken = {key: contents[place] for key, place in choice.places.items()}
    parts = _parts(path, comm, {key: op4.read_matrix(files[key], comm, matrix) for key, matrix in taken.items()},
                   {key: f"{files[key]}, matrix {taken[key].name}" for key in taken}, names)  # fmt: skip
    parts.warnings += [*_left_out(path, names, se, choice, variables), *warnings]
    parts.matrices, number = _without_empty_rows(comm, parts.matrices, parts.warnings)
    if rows is not None:
        _label_rows(comm, parts, rows, number)
    return parts


def _parts(path, comm, matrices, origins, names) -> Parts:
    """Return the parts of matrices that fit each other, without a D of zeros, and which they are. Collective."""
    if "D" in matrices and not comm.allreduce(len(matrices["D"].values)):
        del matrices["D"], origins["D"]
    _check(comm, matrices, origins)
    return Parts(matrices, origins, warnings=[_taken(path, origins, names)])


def _op4_files(path, comm):
    """Return all matrices of a file, and the file of each; those of OP4 files of the same name where it has no pair."""
    contents = op4.contents(path, comm)
    with agreed(comm):
        is_op2 = op2.begins(first_bytes(path))
    files = [path] * len(contents)
    if is_op2 and not contents:
        raise InputError(
            f"{path}: found an OP2 of Nastran, without matrices, of which nodes and sets of dofs are read; give the "
            ".op4 or .pch of the run, and leave this one beside it"
        )
    if not is_op2 and not pairs([matrix.name for matrix in contents]):
        for file in decided(comm, _beside, path, op4.begins):
            matrices = op4.contents(file, comm)
            contents, files = contents + matrices, files + [file] * len(matrices)
    return files, contents


def _beside(path, begins):
    """Return the files of the same name of a kind."""
    return [file for file in bulk.beside(path) if begins(first_bytes(file))]


def _superelements(files, contents, comm):
    """Return the number of the superelement of each matrix, as matrices SE_START say, else None. Collective."""
    numbers, number = [], None
    starts = [file for file, matrix in zip(files, contents, strict=True) if matrix.name == "SE_START"]
    if starts and "LOOP_END" not in {matrix.name for matrix in contents}:
        raise damaged_file(starts[0], "matrices SE_START, but no LOOP_END behind the last", "cut off")
    for file, matrix in zip(files, contents, strict=True):
        if matrix.name == "SE_START" and matrix.shape == (1, 1):
            values = comm.allgather(op4.read_matrix(file, comm, matrix).values)
            number = int(np.concatenate(values).sum())
        numbers.append(number)
    return numbers


def _choices(path, names, se, variables):
    """Return pairs of matrices, the best first. Raises InputError."""
    # names of the user go before all guesses
    if variables:
        places = named(path, names, variables)
        if not {"K", "M"} <= set(places):
            best = next(iter(pairs(names)), Choice({}, None))
            places = {**best.places, **places}
        if not {"K", "M"} <= set(places):
            raise none_found(path, names)
        return [Choice(places, letter_of(names[places["K"]]))]
    # pairs of each superelement by itself
    choices = []
    for number in sorted(set(se), key=lambda superelement: -1 if superelement is None else superelement):
        mine = [k for k, superelement in enumerate(se) if superelement == number]
        for choice in pairs([names[k] for k in mine]):
            choices.append((number, Choice({key: mine[k] for key, k in choice.places.items()}, choice.letter)))
    if not choices:
        raise none_found(path, names)
    # the residual structure, or the only superelement there is
    groups = sorted({number for number, _ in choices if number is not None})
    chosen = 0 if 0 in groups else groups[0] if len(groups) == 1 else None
    if groups and chosen is None:
        raise InputError(
            f"{path}: found matrices of the superelements {', '.join(map(str, groups))}, expected those of one or of "
            "the residual structure (0); choose by --variables K=KAA:1,M=MAA:1"
        )
    choices = [choice for number, choice in choices if not groups or number == chosen]
    # one name must be one matrix
    for key, place in choices[0].places.items():
        again = [k for k, name in enumerate(names) if name == names[place] and se[k] == se[place]]
        if len(again) > 1:
            raise InputError(
                f"{path}: found {len(again)} matrices {names[place]}; choose by --variables {key}={names[place]}:1"
            )
    return choices


def _left_out(path, names, se, choice, variables) -> list[str]:
    """Return which superelement was taken without being named, where there are several, and how others are."""
    number = se[choice.places["K"]]
    groups = sorted(set(se) - {None})
    if variables or len(groups) < 2:
        return []
    ways = []
    for other in groups:
        places = {key: next((k for k, name in enumerate(names) if name == names[place] and se[k] == other), None)
                  for key, place in choice.places.items()}  # fmt: skip
        if other != number and None not in places.values():
            ways.append(f"{other} by --variables " + ",".join(
                f"{key}={names[k]}:{names[: k + 1].count(names[k])}" for key, k in places.items()))  # fmt: skip
    taken = "the residual structure (0)" if number == 0 else f"superelement {number}"
    return [f"{path}: has the superelements {', '.join(map(str, groups))}, of which {taken} is taken; others are: "
            f"{'; '.join(ways)}"] if ways else []  # fmt: skip


def _taken(path, origins, names):
    text = ", ".join(f"{key} is {where.rsplit(' ', 1)[-1]}" for key, where in origins.items())
    others = sorted(set(names) - {where.rsplit(" ", 1)[-1] for where in origins.values()})
    left = f"; not read: {', '.join(others)}" if others else ""
    structural = [name for name in others if name.startswith(STRUCTURAL)]
    hint = f" ({structural[0]} is structural damping: give a loss factor in the job)" if structural else ""
    return f"{path}: {text}{left}{hint}"


def _check(comm, matrices, origins):
    """Refuse matrices that do not fit each other, or a stiffness or mass that is not symmetric. Collective."""
    for key in ("K", "M"):
        defect = asymmetry(comm, matrices[key])
        if not defect <= SYMMETRIC_IN_FILE:
            raise InputError(
                f"{origins[key]}: found ||A - A^T|| / ||A|| = {defect:.1e} (scaled to a diagonal of 1), expected a "
                "symmetric matrix; the file is damaged, or the model has follower forces or the like"
            )
    if isinstance(matrices["K"], LabelledEntries):
        return
    size = matrices["K"].shape
    for key, matrix in matrices.items():
        if matrix.shape != size or size[0] != size[1]:
            raise InputError(
                f"{origins[key]}: found {matrix.shape[0]} x {matrix.shape[1]}, but {origins['K']} is "
                f"{size[0]} x {size[1]}, expected square matrices of one size"
            )


def _rows_of(path, comm, candidates, insisted):
    """Return _Rows or None, and warnings, of the first of candidates (choice, size, superelement) with known rows."""
    op2_file, files = decided(comm, _companions, path)
    if op2_file is None and not files:
        return None, candidates[0][0], [f"{path}: the nodes are not known; {NO_USET}"]
    # points are known from tables of an OP2 file, from the input file, or both
    groups = op2.points_by_superelement(op2_file, comm) if op2_file else []
    if op2_file == path and not groups and not files:
        return None, candidates[0][0], [f"{path}: found no tables BGPDT, EQEXIN and CSTM of all points; the nodes are "
                                        "not known; put the input file of the same name beside it"]  # fmt: skip
    numbered = None not in [se for *_, se in candidates]
    decks = [bulk.read_deck(file, comm, section) for file in files
             for section in (bulk.sections_of(file, comm) if numbered else [None])]  # fmt: skip
    decks = [deck for deck in decks if comm.allreduce(len(deck.label))]
    reasons = []
    # the first matrices whose number of rows one of the sets of points has
    for choice, size, se in candidates:
        letters = [choice.letter] if choice.letter else list(SETS)
        of_se = [group for group in groups if se is None or group[0] in (None, se)]
        own = [deck for deck in decks if deck.superelement in (None, se)]
        for deck, letter in [(deck, letter) for deck in (None, *own) for letter in letters]:
            if deck is None:
                rows = _rows_of_op2(op2_file, of_se, own, comm, letter, size)
            else:
                rows, reason = _rows_of_deck(deck, comm, letter, size)
            if rows is not None:
                passed = [f"matrices with all constraints are there, but {first}: their rows cannot be named"
                          for first in reasons[:1]]  # fmt: skip
                return rows, choice, [*passed, *_said_of_rows(comm, rows, letter)]
            reasons += [] if deck is None else [f"{deck.path} has {reason}"]
        # why these were passed over
        if groups and not decks:
            counts = {points.count(comm, points.of_set(letter)) for _, points in groups for letter in letters}
            reasons.append(f"{op2_file} has {' or '.join(map(str, sorted(counts)))} dofs in such a set")
        if insisted:
            break
    if not reasons:
        reasons.append(f"{op2_file} has no tables BGPDT, EQEXIN and CSTM of all points")
    raise InputError(
        f"{path}: found matrices of {candidates[0][1]} rows, but {reasons[0]}; which dofs the rows are cannot be told: "
        "give the OP2 of the run with the tables BGPDT and USET the same name, or export KGG and MGG, or move the "
        "other files away to read the matrices without nodes"
    )


def _companions(path):
    """Return the OP2 with tables, or None, and the input files. Raises InputError for an .op2 that is none."""
    beside = bulk.beside(path)
    op2_file = next((file for file in (path, *beside) if op2.begins(first_bytes(file))), None)
    other = next((file for file in beside if op2_file is None and file.suffix.lower() == ".op2"), None)
    if other is not None:
        raise InputError(f"{other}: found a file that begins with {first_bytes(other)[:12]!r}, expected one of OUTPUT2")
    return op2_file, bulk.companions(path)


def _rows_of_op2(file, groups, decks, comm, letter, size):
    """Return _Rows of a set from the points of an OP2, with better places of input files; None if none has the size."""
    fitting = [(number, points) for number, points in groups if points.count(comm, points.of_set(letter)) == size]
    if not fitting:
        return None
    _, points = next((group for group in fitting if group[0] == 0), fitting[-1])
    mask = points.of_set(letter)
    for deck in decks:
        if points.rough:
            points = refined(comm, points, bulk.points_of(deck, comm))
    return _Rows(points, mask, file, next((deck for deck in decks if deck.elements), None))


def _rows_of_deck(deck, comm, letter, size):
    """Return _Rows of a set from the input file, or why not."""
    points = bulk.points_of(deck, comm)
    if letter != "G":
        reason = mark_sets(deck, comm, points)
        if reason:
            return None, reason
    counts = [points.count(comm, points.of_set(letter))]
    if counts[0] != size and letter != "G" and hold_rotations_of_solids(deck, comm, points):
        counts.append(points.count(comm, points.of_set(letter)))
    if counts[-1] != size:
        return None, f"{' or '.join(map(str, dict.fromkeys(counts)))} dofs in the set {letter}"
    return _Rows(points, points.of_set(letter), deck.path, deck), None


def _said_of_rows(comm, rows, letter):
    points, source = rows.points, rows.source
    held = comm.allreduce(int(np.count_nonzero(points.there() & (points.marks & HELD > 0))))
    gone = points.count(comm, points.there()) - points.count(comm, rows.mask)
    notes = [f"nodes and sets of dofs are those of {source}"]
    if letter == "G":
        notes.append(LOOSE.format("KAA and MAA"))
    else:
        if held:
            notes.append(f"{held} dofs are held by supports: their mass is missing in the mass of the body")
        if gone > held:
            notes.append(f"{gone - held} dofs have no row, since they depend on others or were condensed")
    if points.rough:
        notes.append(f"{source} gives places with 7 digits only, in which rigid-body motions of the nodes meet forces; "
                    "put the input file beside it")  # fmt: skip
    return notes


def _without_empty_rows(comm, matrices, warnings):
    """Return the matrices without rows that have no entry, and the old numbers of the new rows of this rank."""
    size = matrices["K"].shape[0]
    used = [np.unique(matrix.rows[matrix.values != 0]) for matrix in matrices.values()]
    kept, _ = number_over_ranks(comm, np.concatenate(used))
    count = comm.allreduce(len(kept))
    if count == size:
        return matrices, None
    warnings.append(f"{size - count} rows without stiffness and mass were left out")
    first = comm.exscan(len(kept)) or 0
    result = {}
    for key, matrix in matrices.items():
        asked = np.unique(np.concatenate([matrix.rows, matrix.columns]))
        has_row, (new,) = look_up(comm, kept, [first + np.arange(len(kept))], asked)
        i, j = (np.searchsorted(asked, end) for end in (matrix.rows, matrix.columns))
        there = has_row[i] & has_row[j]
        result[key] = Entries((count, count), new[i[there]], new[j[there]], matrix.values[there])
    return result, kept


def _label_rows(comm, parts, rows, kept):
    """Label numbered rows, in x, y, z as far as they go, and turn the matrices."""
    points, mask = rows.points, rows.mask
    counts = comm.allgather(int(mask.sum()))
    number = np.full(mask.shape, -1)
    number[mask] = sum(counts[: comm.rank]) + np.arange(counts[comm.rank])
    if kept is not None:
        there, (new,) = look_up(comm, kept, [(comm.exscan(len(kept)) or 0) + np.arange(len(kept))], number[mask])
        number[mask] = np.where(there, new, -1)
        mask = number >= 0
    turn = turn_of(points, mask, number, by_label=False)
    _turn(comm, parts, turn)
    parts.row_labels = turn.label[mask], number[mask]
    _finish(comm, parts, rows, turn, mask)


def _turn(comm, parts, turn):
    parts.matrices = {key: turned_entries(comm, turn, matrix) for key, matrix in parts.matrices.items()}


def _finish(comm, parts, rows, turn, mask):
    """Add nodes, elements, held dofs, and messages on rotated ones."""
    points = rows.points
    parts.nodes = NodeTable.as_given(comm, points.label, points.position)
    if rows.deck is not None:
        parts.take_mesh(rows.deck, rows.deck.remarks)
    held = points.there() & ~mask & (points.marks & HELD > 0)
    label = points.local_labels()
    for low in (0, 3):
        at = points.turned[~held[points.turned, low : low + 3].all(axis=1)]
        label[at, low : low + 3] = label_of(points.label[at, None], OWN + low + np.arange(3))
    parts.removed = label[held]
    parts.warnings += _said_of_turn(comm, points, turn)
    scalars = comm.allreduce(int(np.count_nonzero(mask[points.scalar])))
    if scalars:
        parts.warnings.append(f"{scalars} rows are scalar dofs (modal coordinates or scalar points), without a place")


def _said_of_turn(comm, points, turn):
    turned, own = (comm.allreduce(count) for count in (len(points.turned), turn.own))
    if turned:
        yield f"{turned} nodes have displacement systems of their own (CD); their rows were turned to x, y, z"
    if own:
        yield (
            f"{own} rows of such nodes stay in their own directions (own1 to own6), since not all three directions of "
            "the node have rows: pictures and interface nodes leave them out"
        )


def read_bulk(path, comm, variables=None) -> Parts:
    """Return the model of DMIG cards, or of an input file with OP4 or a punch file beside it. Collective."""
    path = Path(path)
    # sections of a file with several superelements are read as files of their own
    contents = [(section, matrix) for section in bulk.sections_of(path, comm)
                for matrix in dmig.contents(path, comm, section)]  # fmt: skip
    if not contents:
        return _read_beside(path, comm, variables)
    names = [matrix.name for _, matrix in contents]
    with agreed(comm):
        se = [section and section.number for section, _ in contents]
        choice = _choices(path, names, se, variables)[0]
        section = contents[choice.places["K"]][0]
        if other := next((key for key, place in choice.places.items() if contents[place][0] != section), None):
            raise InputError(f"{path}: found K and {other} in two sections BEGIN SUPER, expected those of one "
                             "superelement; name others by --variables")  # fmt: skip
    wanted = {key: contents[place][1] for key, place in choice.places.items()}
    matrices, warnings, lacking = dmig.read_matrices(path, comm, wanted, section)
    parts = _parts(path, comm, matrices, {key: f"{path}, matrix {wanted[key].name}" for key in wanted}, names)
    parts.warnings += [*_left_out(path, names, se, choice, variables), *warnings]
    parts.open_ended, parts.loose = set(matrices), choice.letter == "G"
    if choice.letter == "G":
        parts.warnings.append(LOOSE.format("KAAX and MAAX"))
    deck = bulk.read_deck(path, comm, section)
    if not comm.allreduce(len(deck.label)):
        file = next(iter(decided(comm, bulk.companions, path)), None)
        if file is None:
            if lacking is not None:
                _require_massive_columns(comm, parts, lacking)
            parts.warnings.append(f"{path}: the nodes are not known; put the input file of the same name beside it")
            return parts
        deck = bulk.read_deck(file, comm)
    _label_entries(comm, parts, deck, lacking, path)
    return parts


def read_nodes(path, comm) -> tuple[NodeTable, bulk.Deck, Points]:
    """Return nodes, ascending by number, the Deck and its Points of an input file for other matrices. Collective."""
    deck = bulk.read_deck(path, comm)
    points = bulk.points_of(deck, comm)
    nodes = NodeTable.as_given(comm, points.label[~points.scalar], points.position[~points.scalar])
    return nodes, deck, points


def turn_rows(comm, parts, points, path):
    """Turn rows of matrices from the displacement systems (CD) of an input file to x, y, z. Collective."""
    if not comm.allreduce(len(points.turned)):
        return
    own = points.local_labels()
    if isinstance(parts.matrices["K"], LabelledEntries):
        turn = turn_of(points, present(comm, points, np.concatenate(parts.ends)), own, by_label=True)
    else:
        label, row = parts.row_labels or labels_in_order(comm, parts.nodes, common_size(parts), parts.files["K"])
        there, (number,) = look_up(comm, label, [row], own.ravel())
        mask, number = there.reshape(own.shape), np.where(there, number, -1).reshape(own.shape)
        turn = turn_of(points, mask, number, by_label=False)
        known, (new,) = look_up(comm, own[mask], [turn.label[mask]], label)
        parts.row_labels = np.where(known, new, label), row
    _turn(comm, parts, turn)
    parts.warnings += [f"{path}: {sentence}" for sentence in _said_of_turn(comm, points, turn)]
    parts.warnings.append(
        f"{path}: matrices of Nastran are in these systems; where those of another program are in x, y, z, as the "
        "forces of rigid-body motions show, delete CD in the GRID cards"
    )


def _read_beside(path, comm, variables):
    """Return the matrices beside an input file."""
    of_op4, punch, of_op2 = (decided(comm, _beside, path, kind.begins) for kind in (op4, dmig, op2))
    if of_op4:
        return read_op4(of_op4[0], comm, variables)
    if punch:
        return read_bulk(punch[0], comm, variables)
    if of_op2 and op4.contents(of_op2[0], comm):
        return read_op4(of_op2[0], comm, variables)
    raise InputError(
        f"{path}: found an input file of Nastran without matrices, expected {path.stem}.op4, {path.stem}.pch or "
        f"{path.stem}.op2 with them beside it; see docs/formats-nastran.md for what to type in Nastran"
    )


def _label_entries(comm, parts, deck, lacking, path):
    """Label entries in x, y, z as far as they go, with the nodes of an input file; `lacking`: see dmig."""
    points = bulk.points_of(deck, comm)
    _name_scalars(comm, parts, points)
    mask = present(comm, points, np.concatenate(parts.ends))
    reason = mark_sets(deck, comm, points)
    if lacking is not None:
        _require_whole_set(comm, parts, deck, points, mask, lacking, reason)
    turn = turn_of(points, mask, points.local_labels(), by_label=True)
    _turn(comm, parts, turn)
    parts.warnings.append(f"nodes are those of {deck.path}")
    held = points.count(comm, points.there() & ~mask & (points.marks & HELD > 0))
    if held and not reason:
        parts.warnings.append(f"{held} dofs are held by supports: their mass is missing in the mass of the body")
    _finish(comm, parts, _Rows(points, mask, deck.path, deck), turn, mask)
    of_this_run = Path(path) != Path(deck.path)  # and not matrices that were put into another model
    if of_this_run and not (held or reason or comm.allreduce(turn.own)):
        parts.warnings += compare_mass(comm, path, deck, parts.matrices["M"])


def _require_whole_set(comm, parts, deck, points, mask, lacking, reason):
    """Raise InputError unless K lacks only dofs without row; where it announces those of the model, say so."""
    total = points.count(comm, points.there())
    if total != lacking.matrix.columns:
        _require_massive_columns(comm, parts, lacking)
        return
    of_K = present(comm, points, parts.matrices["K"].columns)
    ends = comm.allgather(points.local_labels()[mask & ~of_K][:1].tolist())
    if lost := sum(ends, []):
        raise lacking.error(f" or a reason why {label_name(lost[0])} has mass but no stiffness; the file is cut off or "
                            "damaged")  # fmt: skip
    hold_rotations_of_solids(deck, comm, points)
    parts.warnings.append(
        f"{lacking.path}: the header of {lacking.matrix.name} counts all {total} dofs of {deck.path}, of which "
        f"{total - lacking.there} have no row"
    )
    untold = points.count(comm, points.there() & ~mask & (points.marks & SETS["A"] == 0))
    if reason:
        parts.warnings.append(f"{deck.path}: found {reason}; which dofs have no row is taken from the matrices")
    elif untold:
        parts.warnings.append(
            f"{untold} of these no card of {deck.path} takes away; they are taken as those without stiffness, which "
            "AUTOSPC holds"
        )


def _require_massive_columns(comm, parts, lacking):
    """Raise InputError where M has columns that K lacks, else warn of the number that its header card says."""
    K, M = (np.unique(parts.matrices[key].columns) for key in "KM")
    there, _ = look_up(comm, number_over_ranks(comm, K)[0], [], M)
    if lost := sum(comm.allgather(M[~there][:1].tolist()), []):
        raise lacking.error(f": {label_name(lost[0])} has mass but no stiffness; the file is cut off or damaged")
    parts.warnings.append(
        f"{lacking.path}: the header card of {lacking.matrix.name} says {lacking.matrix.columns} columns, and "
        f"{lacking.there} are there, all those of M; the number counts for rectangular matrices only, and is not used"
    )


def _name_scalars(comm, parts, points):
    """Replace direction 1 of scalar points by that of a scalar."""
    if not comm.allreduce(int(points.scalar.sum())):
        return
    mine = points.label[points.scalar]
    for matrix in parts.matrices.values():
        for end in ("rows", "columns"):
            label = getattr(matrix, end)
            node, direction = np.divmod(label, STRIDE)
            there, _ = look_up(comm, mine, [mine], node)
            setattr(matrix, end, np.where(there & (direction == 0), label_of(node, np.full(len(node), SCALAR)), label))


class Op4(Reader):
    """Matrices of OUTPUT4."""

    name, told_by, named = "Nastran OP4", "the header of its first matrix", True
    companions = "other .op4 files, .op2, .bdf or .dat with nodes"
    begins = staticmethod(op4.begins)
    read_matrix, read_model = staticmethod(op4.read), staticmethod(read_op4)


class Op2(Reader):
    """Matrices in OUTPUT2."""

    name, told_by, named = "Nastran OP2 with matrices", "its records of one number", True
    companions = ".bdf or .dat with nodes"
    begins = staticmethod(op2.begins)
    read_matrix, read_model = staticmethod(op4.read), staticmethod(read_op4)


class Bulk(Reader):
    """DMIG cards, or an input file."""

    name, told_by, named = "Nastran DMIG, or an input file with the matrices beside it", "DMIG or other cards", True
    companions = ".pch or .op4 with the matrices, .bdf or .dat with nodes"
    begins, read_model = staticmethod(begins_bulk), staticmethod(read_bulk)


# Read the mass that a Nastran run reports, to check a mass matrix from a file without end mark.


def compare_mass(comm, path, deck, M: LabelledEntries) -> list[str]:
    """Compare the mass of M, without supports, with a listing or point masses; InputError if less. Collective."""
    same = (M.rows % STRIDE == M.columns % STRIDE) & (M.rows % STRIDE < 3)
    mass = float(max(comm.allreduce(np.bincount(M.rows[same] % STRIDE, M.values[same], 3))))  # in x, y, z
    told, source = decided(comm, _told, path)
    exact = told is not None
    if not exact:
        told, source = deck.point_mass, f"the CONM2 of {deck.path} sum up to"
    told *= deck.mass_unit
    if mass < (1 - SAME) * told:
        raise InputError(
            f"{path}: found a mass of {mass:.6g} in M, while {source} {told:.6g}; the file is cut off, or of another "
            "run: export it again"
        )
    if exact and mass > (1 + SAME) * told:
        return [f"{path}: M has a mass of {mass:.6g}, while {source} {told:.6g}; the two are of different runs"]
    return [f"{path}: the mass of M, {mass:.6g}, is what {source}"] if exact else []


def _told(path):
    """Return the mass of the grid point weight generator in a listing of the same name, and words for it, or None."""
    for file in beside(path):
        if file.suffix.lower() == ".f06":
            with open_unpacked(file) as text:
                masses = {float(match["mass"]) for match in WEIGHT.finditer(text.read(LONGEST))}
            if len(masses) == 1:
                return masses.pop(), f"the grid point weight in {file} says"
    return None, None
