"""Read frequency responses, measured or computed: universal files (dataset 58), .npz, .mat, and those of hpcred.

For the arrays of .npz and .mat see files.frf_file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..fe.dofs import DIRECTIONS, QUANTITIES, named_quantity, quantity_name
from ..files.frf_file import FRF, QUANTITY_NUMBERS, universal
from ..files.response_file import Responses, read_responses
from ..files.text import absent
from ..parallel.failures import InputError


def read_frf(path) -> Responses:
    """Return the responses of displacements in SI of a universal file, .npz, .mat or one of hpcred, with `places`:
    number and position of nodes by name, as far as they are known. On this rank. Raises InputError."""
    path = Path(path)
    if not path.is_file():
        raise absent(path)
    ending = path.suffix.lower()
    if ending in (".unv", ".uff", ".uf"):
        responses = _read_universal(path)
    elif ending in (".npz", ".mat"):
        responses = _read_arrays(path, ending)
    elif ending in (".h5", ".hdf5"):
        responses = read_responses(path)
        if responses.response is None:
            responses.response = responses.full if responses.reduced is None else responses.reduced
    else:
        raise InputError(f"{path}: found the ending '{ending}', expected .unv, .uff, .npz, .mat or .h5")
    F, H = responses.frequencies, responses.response
    if H is None or H.shape != (len(F), len(responses.output_names), len(responses.input_names)) or not len(F):
        shape = "none" if H is None else H.shape
        raise InputError(f"{path}: found responses {shape}, expected one for each of {len(F)} frequencies, "
                         f"{len(responses.output_names)} outputs and {len(responses.input_names)} inputs")  # fmt: skip
    if not (np.isfinite(F).all() and np.isfinite(H).all()) or (np.diff(F) <= 0).any() or F[0] < 0:
        raise InputError(f"{path}: found frequencies that do not ascend, or numbers that are not finite")
    return _displacements(responses, path)


def _displacements(found, path) -> Responses:
    """Return responses of velocities and accelerations as those of displacements."""
    order = [QUANTITIES.index(named_quantity(name)[0]) for name in found.output_names]
    names = tuple(named_quantity(name)[1] for name in found.output_names)
    if any(order) and found.frequencies[0] == 0:
        found.frequencies, found.response = found.frequencies[1:], found.response[1:]  # which tell nothing of rest
    s = 2j * np.pi * found.frequencies
    H = found.response / s[:, None, None] ** np.array(order)[:, None] if any(order) else found.response
    if len(set(names)) < len(names) or len(set(found.input_names)) < len(found.input_names):
        raise InputError(f"{path}: found an output or an input twice, expected each once")
    return Responses(frequencies=found.frequencies, input_names=found.input_names, output_names=names, response=H,
                     places=found.places)  # fmt: skip


def _read_arrays(path, ending) -> Responses:
    try:
        if ending == ".npz":
            with np.load(path, allow_pickle=False) as file:
                data = dict(file)
        else:
            from scipy.io import loadmat

            data = loadmat(path, squeeze_me=False, chars_as_strings=True)
    except Exception as error:
        raise InputError(f"{path}: cannot be read ({str(error)[:80]}); expected {ending} with frequencies, H, "
                         "input_names and output_names") from error  # fmt: skip
    if missing := [key for key in ("frequencies", "H", "input_names", "output_names") if key not in data]:
        raise InputError(f"{path}: found no {missing[0]}, expected frequencies, H, input_names and output_names")
    names = {key: tuple(_text(item) for item in np.ravel(data[key]))
             for key in ("input_names", "output_names", "node_names") if key in data}  # fmt: skip
    F, H = np.ravel(data["frequencies"]).astype(float), np.asarray(data["H"], dtype=complex)
    shape = len(F), len(names["output_names"]), len(names["input_names"])
    if H.ndim < 3 and H.size == np.prod(shape) and (len(H) == len(F) or H.size == len(F)):  # one input or one output
        H = H.reshape(shape)
    places = {}
    if {"node_names", "nodes", "positions"} <= data.keys():
        numbers, positions = np.ravel(data["nodes"]), np.atleast_2d(data["positions"])
        if not len(names["node_names"]) == len(numbers) == len(positions) or positions.shape[1] != 3:
            raise InputError(f"{path}: found {len(names['node_names'])} node_names, {len(numbers)} nodes and positions "
                             f"{positions.shape}, expected as many of each, (k, 3)")  # fmt: skip
        rows = zip(names["node_names"], numbers.tolist(), positions, strict=True)
        places = {name: (int(number), np.array(place, dtype=float)) for name, number, place in rows}
    return Responses(frequencies=F, response=H, input_names=names["input_names"], output_names=names["output_names"],
                     places=places)  # fmt: skip


def _text(item) -> str:
    """Return a text of NumPy, or of a cell of MATLAB."""
    while isinstance(item, np.ndarray):
        item = item.ravel()[0] if item.size else ""
    return (item.decode() if isinstance(item, bytes) else str(item)).strip()


def _read_universal(path) -> Responses:
    pyuff = universal()
    try:
        sets = pyuff.UFF(str(path)).read_sets()
        sets = sets if isinstance(sets, list) else [sets]
    except Exception as error:
        raise InputError(f"{path}: cannot be read ({str(error)[:80]}), expected a universal file with datasets 58"
                         ) from error  # fmt: skip
    functions = [item for item in sets if item["type"] == 58 and item.get("func_type") == FRF]
    if not functions:
        raise InputError(f"{path}: found no frequency response (dataset 58, function 4), expected one for each pair")
    units = next((item for item in sets if item["type"] == 164), None)
    force, length = (1.0, 1.0) if units is None else (units["force"], units["length"])  # of the file in one of SI
    # one response for each pair, on the same lines
    F, columns = np.asarray(functions[0]["x"], dtype=float), {}
    for item in functions:
        if len(item["x"]) != len(F) or not np.allclose(item["x"], F, rtol=1e-6, atol=1e-9 * F[-1]):
            raise InputError(f"{path}: found responses at different frequencies, expected the same in all")
        signs = [np.sign(item[key]) or 1 for key in ("rsp_dir", "ref_dir")]
        output, given = (_name(item, key, path) for key in ("rsp", "ref"))
        number = int(item.get("ordinate_spec_data_type") or 0)
        if number not in QUANTITY_NUMBERS:
            raise InputError(f"{path}: found a response of the quantity {number}{' (unknown)' * (not number)}, "
                             "expected displacements (8), velocities (11) or accelerations (12); export it with its "
                             "quantity, or as .npz with names such as 'acceleration 20:z'")  # fmt: skip
        output = quantity_name(QUANTITIES[QUANTITY_NUMBERS.index(number)], output)
        if (output, given) in columns:
            raise InputError(f"{path}: found the response {output}/{given} twice, expected each once; keep one")
        # rotations and moments have other units of length
        turns, moment = (abs(int(item[key])) > 3 for key in ("rsp_dir", "ref_dir"))
        factor = force * length ** (moment - (not turns))
        columns[output, given] = np.asarray(item["data"], dtype=complex) * factor * signs[0] * signs[1]
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in columns)) for k in (0, 1))
    lacking = [f"{j}/{i}" for j in outputs for i in inputs if (j, i) not in columns]
    if lacking:
        raise InputError(f"{path}: found no response {lacking[0]}, expected one for each pair of {len(outputs)} "
                         f"outputs and {len(inputs)} inputs; {len(lacking)} are missing")  # fmt: skip
    H = np.array([[columns[j, i] for i in inputs] for j in outputs]).transpose(2, 0, 1)
    # places of nodes, by the names that the responses have
    where = {int(n): np.array(place) / length for item in sets if item["type"] in (15, 2411)
             for n, *place in zip(item["node_nums"], item["x"], item["y"], item["z"], strict=True)}  # fmt: skip
    places = {}
    for item in functions:
        for key in ("rsp", "ref"):
            number = int(item[f"{key}_node"])
            if number in where:
                places[_name(item, key, path).rpartition(":")[0]] = (number, where[number])
    return Responses(frequencies=F, response=H, input_names=inputs, output_names=outputs, places=places)


def _name(item, key, path) -> str:
    """Return the name of the output or input of a dataset 58: its entity, or else its node, and its direction."""
    direction = abs(int(item[f"{key}_dir"]))
    if not 1 <= direction <= 6:
        raise InputError(f"{path}: found the direction {item[f'{key}_dir']}, expected 1 to 6 for x to rz")
    entity = str(item.get(f"{key}_ent_name", "NONE")).strip()
    node = entity if entity not in ("", "NONE") else str(int(item[f"{key}_node"]))
    return f"{node}:{DIRECTIONS[direction - 1]}"


