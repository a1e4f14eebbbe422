"""Read HDF5 files of hpcred: values are checked against their checksums, shapes against a table.

A file keeps, beside a dataset `a/b`, the sums of its chunks as `checksums/a/b` (leading, chunks), see
files.checksums, with the attribute `axis` of the rows, -1 for all in a line; and in the attribute `xxh3` that of the
other attributes and of the names of all datasets. Files of earlier versions have no such attribute, and other sums or
none: they are read without checks of values.
"""

import json
from functools import partial
from math import prod
from typing import NamedTuple

import h5py
import numpy as np

from ..parallel.failures import InputError
from .checksums import ROWS_OF_SUM, hashed, sums_of, tag_of
from .opened_hdf5 import damaged, guarded, own_item

SUMS = "checksums"
CHECKSUM = "xxh3"  # the attribute
KINDS = {"integer": "iu", "real": "f", "complex": "c", "text": "SO", "flag": "b"}
DEEPEST = 8  # groups in groups
HAND = 2**19  # bytes that the processor keeps at hand


class Array(NamedTuple):
    """A dataset of a kind of file: one of KINDS, its sizes (numbers, or letters that stand for one number throughout
    the file, with +1 perhaps, or ? for any), and whether it is always there."""

    kind: str
    shape: tuple
    needed: bool = False


def header_checksum(attributes: dict, names) -> int:
    """The XXH3 of the attributes of a file, but for itself, and of the names of its datasets."""
    kept = {key: value for key, value in attributes.items() if key != CHECKSUM}
    text = json.dumps([kept, sorted(names)], sort_keys=True, default=_plain)
    return hashed(text.encode())


def _plain(value):
    """What HDF5 gives as an attribute, for JSON."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


class CheckedFile:
    """A file that is open, with `attributes`, and `datasets` by name. Indexing works as in h5py; raises InputError.

    `schema`: entries by name, or by the name of the group and /* for those that have any name in it. `complete`:
    whether the file has checksums.
    """

    def __init__(self, file, path, schema=None):
        self.path = path
        with guarded(path, "the list of its contents"):
            self.attrs = dict(file.attrs)
            self.datasets = dict(own_datasets(file, path))
        self._check_names(path)
        self._check_shapes(schema or {})

    def _check_names(self, path):
        """Give datasets their sums."""
        sums = {name: dataset for name, dataset in self.datasets.items() if name.startswith(SUMS + "/")}
        for name in sums:
            del self.datasets[name]
        self.complete = CHECKSUM in self.attrs
        if self.complete:
            if self.attribute(CHECKSUM) != header_checksum(self.attrs, self.datasets):
                raise damaged(path, "the attributes, or the names of the datasets, do not have their checksum")
            for name, dataset in self.datasets.items():
                if f"{SUMS}/{name}" not in sums:
                    raise damaged(path, f"/{name} has no checksum")
                self.datasets[name] = CheckedDataset(dataset, sums[f"{SUMS}/{name}"], path)
        else:
            self.datasets = {name: CheckedDataset(dataset, None, path) for name, dataset in self.datasets.items()}

    def __contains__(self, name):
        return name in self.datasets or any(key.startswith(name + "/") for key in self.datasets)

    def __getitem__(self, name):
        """A dataset or a group."""
        if name in self.datasets:
            return self.datasets[name]
        if name in self:
            return CheckedGroup(self, name + "/")
        raise damaged(self.path, f"/{name} is missing")

    def get(self, name, default=None):
        return self[name] if name in self else default  # noqa: SIM401

    def attribute(self, name, kind=int, default=None):
        """An attribute as a number or text."""
        value = self.attrs.get(name, default)
        try:
            return kind(value.decode() if isinstance(value, bytes) else value)
        except (TypeError, ValueError, OverflowError) as error:
            raise damaged(self.path, f"the attribute {name} is missing or no {kind.__name__}: {value!r}") from error

    def table(self, name) -> dict:
        """The table that a text holds as JSON. Raises InputError."""
        try:
            parsed = json.loads(self[name][()])
        except InputError:
            raise
        except (ValueError, TypeError, RecursionError) as error:
            raise damaged(self.path, f"/{name} is no table in JSON ({type(error).__name__})") from error
        if not isinstance(parsed, dict):
            raise damaged(self.path, f"/{name} is no table in JSON, but {type(parsed).__name__}")
        return parsed

    def verify(self, first=lambda rows: (0, rows)) -> int:
        """Check all datasets, of each the rows that `first` names (low, high); returns their number."""
        for dataset in self.datasets.values():
            dataset.verify(*first(dataset.rows))
        return len(self.datasets)

    def _check_shapes(self, schema):
        sizes = {"n": self.attribute("size")} if "size" in self.attrs else {}
        for name, entry in schema.items():
            if entry.needed and name not in self.datasets:
                raise self._unfit(f"/{name} is missing")
        for name, dataset in self.datasets.items():
            entry = schema.get(name) or schema.get(name.rpartition("/")[0] + "/*")
            if entry is None:
                continue
            expected = [_size(size, sizes, length) for size, length in zip(entry.shape, dataset.shape, strict=False)]
            right = dataset.dtype.kind in KINDS[entry.kind] and len(entry.shape) == dataset.ndim
            if not right or expected != list(dataset.shape):
                actual = f"{dataset.dtype} of shape {dataset.shape}"
                shape = tuple(sizes.get(size, size) for size in entry.shape)
                raise self._unfit(f"/{name} is {actual}, expected {entry.kind} of shape {shape}")

    def _unfit(self, what):
        """What to raise for a dataset that is missing or of another shape: of a file that a user wrote, perhaps."""
        if self.complete:
            return damaged(self.path, what)
        return InputError(f"{self.path}: {what}; 'files' in the documentation lists all arrays, or make the file again")


class CheckedGroup:
    """A group of a CheckedFile: its datasets and groups by their names in it."""

    def __init__(self, file, start):
        self._file, self._start = file, start

    def __contains__(self, name):
        return self._start + name in self._file

    def __getitem__(self, name):
        return self._file[self._start + name]

    def items(self) -> list:
        """Names and datasets of the group itself."""
        own = ((key[len(self._start) :], dataset) for key, dataset in self._file.datasets.items()
               if key.startswith(self._start))  # fmt: skip
        return [(key, dataset) for key, dataset in own if "/" not in key]


def _size(size, sizes, length):
    """The size that is expected where there are `length`; letters get their number where they stand first."""
    if size == "?":
        return length
    if isinstance(size, int):
        return size
    letter, plus, _ = size.partition("+")
    return sizes.setdefault(letter, length - bool(plus)) + bool(plus)


def own_datasets(group, path, before="", depth=0, groups=None):
    """The names and datasets of a group. Raises InputError for what is a link, or kept in another file."""
    groups = {h5py.h5o.get_info(group.id).addr} if groups is None else groups
    for key in group:
        name, member = before + key, own_item(group, key, path)
        if isinstance(member, h5py.Group):
            place = h5py.h5o.get_info(member.id).addr
            if depth == DEEPEST or place in groups:
                wrong = "a second name of a group" if place in groups else f"a group in more than {DEEPEST} groups"
                raise damaged(path, f"/{name} is {wrong}")
            groups.add(place)
            yield from own_datasets(member, path, name + "/", depth + 1, groups)
        elif isinstance(member, h5py.Dataset):
            yield name, member


class CheckedDataset:
    """A dataset; what is read of it is checked, in whole chunks of its rows. `rows` along its axis."""

    def __init__(self, dataset, sums, path):
        self._dataset, self._sums, self.path = dataset, sums, path
        self.name, self.axis = dataset.name, -1
        self.shape, self.dtype = self._guarded(lambda: (dataset.shape, dataset.dtype))
        if self.shape is None:
            raise damaged(path, f"{self.name} is empty")
        self.ndim = len(self.shape)
        if sums is not None:
            self.axis = int(self._guarded(lambda: sums.attrs["axis"]))
            if not -1 <= self.axis < self.ndim:
                raise damaged(path, f"{self.name} does not have its checksum")
            leading, chunks = prod(self.shape[: max(self.axis, 0)]), -(-self.rows // ROWS_OF_SUM)
            if sums.shape != (leading, chunks) or sums.dtype != np.uint64:
                raise damaged(path, f"{self.name} does not have its checksum")
            self._tag = tag_of(self.dtype, self.shape, self.axis)

    @property
    def rows(self) -> int:
        """Number of rows under the sums; one where all of it is checked together."""
        return self.shape[self.axis] if self.axis >= 0 else prod(self.shape)

    def __len__(self):
        return self.shape[0]

    def __getitem__(self, key):
        """Everything for ... or (); rows of the axis for a slice, a number or an array of numbers at its place."""
        if self._sums is None:
            return self._guarded(lambda: self._dataset[key])
        indices = key if isinstance(key, tuple) else (key,)
        leading, last = indices[: self.axis], indices[self.axis] if 0 <= self.axis < len(indices) else slice(None)
        alone = [index for index in leading if isinstance(index, (int, np.integer))]
        everything = not indices or indices[0] is Ellipsis
        others = [index for index in leading if isinstance(index, slice) and index == slice(None)]
        if everything or self.axis < 0 or len(indices) > self.axis + 1 or len(alone) + len(others) < len(leading):
            values = self._between(0, self.rows)
            return values if everything else values[key]
        place = tuple(index if isinstance(index, slice) else slice(index, index + 1) for index in leading)
        if isinstance(last, slice):
            low, high, step = last.indices(self.rows)
            values = self._between(low, max(high, low), place)
            if step != 1:
                raise IndexError(f"{self.name}: a step of {step}")
        else:
            values = self._picked(np.atleast_1d(last), place)
            values = values if np.ndim(last) else np.take(values, 0, axis=self.axis)
        return values[0] if alone else values

    @property
    def digest(self) -> str:
        """Hexadecimal digits that differ where the content does; empty where there are no sums."""
        return "" if self._sums is None else f"{hashed(self._guarded(lambda: self._sums[...]).tobytes()):016x}"

    def verify(self, low, high):
        """Read the rows low .. high and check them."""
        step = max(ROWS_OF_SUM, 2**26 // max(self._dataset.nbytes // max(self.rows, 1), 1) // ROWS_OF_SUM * ROWS_OF_SUM)
        if self.axis < 0:
            low, high, step = (0, self.rows, self.rows) if low == 0 else (0, 0, 1)
        for start in range(low, high, max(step, 1)):
            self._between(start, min(start + step, high))

    def _picked(self, rows, leading):
        """Rows by their numbers, from the chunks that they are in."""
        picked = [np.zeros((*self.shape[: self.axis], 0, *self.shape[self.axis + 1 :]), self.dtype)]
        order = np.argsort(rows, kind="stable")
        for chunk in np.unique(rows // ROWS_OF_SUM):
            block = self._between(chunk * ROWS_OF_SUM, min((chunk + 1) * ROWS_OF_SUM, self.rows), leading)
            mine = np.sort(rows[rows // ROWS_OF_SUM == chunk]) - chunk * ROWS_OF_SUM
            picked.append(np.take(block, mine, axis=self.axis))
        values = np.concatenate([taken for taken in picked if taken.shape[self.axis]] or picked, axis=self.axis)
        return np.take(values, np.argsort(order), axis=self.axis)

    def _between(self, low, high, leading=()):
        """Rows low .. high along the axis, with the chunks that they are in checked; `leading`: slices before it."""
        if self.axis < 0:
            return self._whole()
        begin, end = low // ROWS_OF_SUM * ROWS_OF_SUM, min(-(-high // ROWS_OF_SUM) * ROWS_OF_SUM, self.rows)
        place = (*leading, *[slice(None)] * (self.axis - len(leading)))
        ends = [span.indices(size)[:2] for span, size in zip(place, self.shape, strict=False)]
        sizes = (*(b - a for a, b in ends), end - begin, *self.shape[self.axis + 1 :])
        values, sums = np.empty(sizes, self.dtype.str), []  # MPI knows this byte order
        for start, stop in self._steps(begin, end):
            read = values[start - begin : stop - begin] if self.axis == 0 else values
            self._guarded(partial(self._read, read, [*ends, (start, stop)]))
            sums.append(self._guarded(partial(sums_of, read, self.axis, self._tag)))
        chunks = (place[0] if place else slice(None), slice(begin // ROWS_OF_SUM, -(-end // ROWS_OF_SUM)))
        self._compare(values, np.concatenate(sums, axis=1), chunks)
        return values[(*[slice(None)] * self.axis, slice(low - begin, high - begin))]

    def _whole(self):
        """What has one sum for all of it."""
        content = self._guarded(lambda: self._dataset[()])
        values = np.asarray(content, self.dtype)
        self._compare(values, self._guarded(lambda: sums_of(values.reshape(-1), 0, self._tag)), ())
        return content

    def _steps(self, begin, end):
        """The rows begin .. end in steps: in the order of the file, so few that the processor has them at hand when
        they are summed."""
        if self.axis > 0:
            return [(begin, end)]
        step = max(HAND // max(prod(self.shape[1:]) * self.dtype.itemsize * ROWS_OF_SUM, 1), 1) * ROWS_OF_SUM
        return [(start, min(start + step, end)) for start in range(begin, end, step)] or [(begin, end)]

    def _read(self, values, ends):
        """Fill an array with what is between the `ends` of the first axes; h5py itself writes zeros there first."""
        if values.size:
            there = self._dataset.id.get_space()
            there.select_hyperslab((*(low for low, _ in ends), *[0] * (self.ndim - len(ends))), values.shape)
            self._dataset.id.read(h5py.h5s.create_simple(values.shape), there, values)

    def _compare(self, values, sums, chunks):
        """Compare the sums of values with those of the file."""
        if not np.array_equal(sums, self._guarded(lambda: self._sums[chunks])):
            others = values.dtype.kind in "fc" and not np.isfinite(values).all()
            raise damaged(self.path, f"{self.name} does not have its checksum"
                                     f"{', and has entries that are not finite' * others}")  # fmt: skip

    def _guarded(self, read):
        with guarded(self.path, self.name):
            return read()
