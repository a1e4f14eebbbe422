"""Write frequency responses as other programs read them: universal files (dataset 58), and .npz with pyFBS' arrays.

A .npz has frequencies (F) in Hz, H (F, r, p) in m/N, output_names (r) and input_names (p), such as "tip:z" or "20:z",
and where they are known node_names (k), nodes (k), their numbers, and positions (k, 3) in m. Beside them it has pyFBS'
form: freq (F), FRF (F, r, p), and the columns of its tables of channels and impacts, chn_Name, chn_Position_1,
imp_Direction_3 and so on.
"""

import io
import sys
from pathlib import Path

import numpy as np

from ..fe.dofs import DIRECTIONS, QUANTITIES, named_quantity, node_of, target_of
from ..model.units import unit_of_input, unit_of_output
from ..parallel.failures import InputError

NEEDS = "universal files of responses need pyuff: pip install 'hpcred[measured]'"
FRF, FREQUENCY, FORCE = 4, 18, 13  # numbers of functions and of quantities in dataset 58
QUANTITY_NUMBERS = (8, 11, 12)  # displacement, velocity, acceleration


def universal():
    """Return pyuff. Raises InputError where it is not installed."""
    try:
        import pyuff
    except ImportError as error:
        raise InputError(NEEDS) from error
    return pyuff


def write_frf(path, responses, H, arrays: bool):
    """Write responses H (F, r, p) as `arrays`, a .npz, or as a universal file, on this rank; `responses`: as
    response_file.Responses. Channels that belong to no node are left out of a universal file. Raises InputError."""
    if arrays:
        nodes = responses.places or {}
        known = {"frequencies": responses.frequencies, "H": H, "input_names": np.array(responses.input_names),
                  "output_names": np.array(responses.output_names), "freq": responses.frequencies, "FRF": H,
                  "node_names": np.array(list(nodes), dtype=str),
                 "nodes": np.array([number for number, _ in nodes.values()], dtype=int),
                  "positions": np.array([place for _, place in nodes.values()]).reshape(-1, 3)}  # fmt: skip
        content = io.BytesIO()  # an archive that is half written, on a full disk, would print an error
        np.savez(content, **known, **_tables(responses))
        Path(path).write_bytes(content.getbuffer())
        return
    pyuff = universal()
    numbers = {name: number for name, (number, _) in (responses.places or {}).items()}
    names = [*responses.output_names, *responses.input_names]
    nodes = dict.fromkeys(str(node_of(name)) for name in names if node_of(name) is not None)
    for node in sorted(nodes, key=lambda node: not node.isdecimal()):  # whose numbers the others have to leave
        numbers.setdefault(node, int(node) if node.isdecimal() else max(numbers.values(), default=0) + 1)
    sets = [pyuff.prepare_164(units_code=1, units_description="SI", temp_mode=1, length=1.0, force=1.0, temp=1.0,
                              temp_offset=273.15)]  # fmt: skip
    if responses.places:
        x, y, z = np.array([place for _, place in responses.places.values()]).T
        there = [number for number, _ in responses.places.values()]
        sets.append(pyuff.prepare_2411(node_nums=there, def_cs=[0] * len(x), disp_cs=[0] * len(x), color=[11] * len(x),
                                       x=x, y=y, z=z))  # fmt: skip
    for j, output in enumerate(responses.output_names):
        for i, input_ in enumerate(responses.input_names):
            if node_of(output) is None or node_of(input_) is None:
                continue
            quantity, place = named_quantity(output)
            (out, d), (into, e) = ((str(node), DIRECTIONS.index(d) + 1) for node, d in map(target_of, (place, input_)))
            sets.append(pyuff.prepare_58(
                binary=1, func_type=FRF, rsp_node=numbers[out], rsp_dir=d, ref_node=numbers[into], ref_dir=e,
                rsp_ent_name=_entity(out), ref_ent_name=_entity(into), data=H[:, j, i], x=responses.frequencies,
                id1=f"{output}/{input_}"[:80], abscissa_spacing=0, abscissa_spec_data_type=FREQUENCY,
                ordinate_spec_data_type=QUANTITY_NUMBERS[QUANTITIES.index(quantity)],
                orddenom_spec_data_type=FORCE, abscissa_axis_units_lab="Hz",
                ordinate_axis_units_lab=unit_of_output(output),
                orddenom_axis_units_lab=unit_of_input(input_),
            ))  # fmt: skip
    if not any(dataset["type"] == 58 for dataset in sets):
        raise InputError("found no input and output at nodes, which a universal file has; take .npz")
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    # pyuff says in the head of each binary dataset how many bytes one real number a frequency would take
    head, F = b"58b%6d%6d%12d" % (1 if sys.byteorder == "little" else 2, 2, 11), len(responses.frequencies)
    text = Path(path).read_bytes().replace(head + b"%12d" % (8 * F), head + b"%12d" % (24 * F))
    Path(path).write_bytes(text)


def _entity(node) -> str:
    """Return the name of a node as an entity, which has ten letters; "NONE" where it does not fit."""
    return node if not node.isdecimal() and len(node) <= 10 else "NONE"


def _tables(responses) -> dict[str, np.ndarray]:
    """Return the columns of pyFBS' tables of channels and impacts."""
    tables = {}
    for prefix, names, force in (("chn", responses.output_names, False), ("imp", responses.input_names, True)):
        rows = []
        for name in names:
            quantity, place = named_quantity(name)
            node, _, direction = place.rpartition(":")
            d = DIRECTIONS.index(direction) if direction in DIRECTIONS[:6] else None
            _, at = (responses.places or {}).get(node, (0, np.full(3, np.nan)))
            unit = (unit_of_input if force else unit_of_output)(name)
            rows.append((name, "Force" if force else quantity.capitalize(), unit, at,
                         np.zeros(3) if d is None else np.eye(3)[d % 3]))  # fmt: skip
        tables |= {f"{prefix}_Name": np.array([row[0] for row in rows]),
                   f"{prefix}_Quantity": np.array([row[1] for row in rows]),
                   f"{prefix}_Unit": np.array([row[2] for row in rows]),
                   f"{prefix}_Grouping": np.ones(len(rows), dtype=int)}  # fmt: skip
        for k in range(3):
            tables[f"{prefix}_Position_{k + 1}"] = np.array([row[3][k] for row in rows])
            tables[f"{prefix}_Direction_{k + 1}"] = np.array([row[4][k] for row in rows])
    return tables
