"""Copy result.h5 with other stress modes; each rank copies its rows."""

from ..parallel.failures import agreed
from ..parallel.shares import row_range
from .checked import CHECKSUM
from .hdf5 import reading, writing
from .result_file import FORMAT, SCHEMA, VERSION, write_stress


def copy_with_stress(source, output, stress, comm):
    """Write `output`, a result with the contents of `source` and the StressModes of all ranks. Collective.

    Raises InputError for a source that is no result.
    """
    with agreed(comm), reading(source, FORMAT, VERSION, SCHEMA) as old:
        names = [name for name in old.datasets if not name.startswith("basis/stress")]
        attributes = {key: value for key, value in old.attrs.items() if key != CHECKSUM}
    with writing(output, comm) as file, reading(source, FORMAT, VERSION, SCHEMA) as old:
        for key, value in attributes.items():
            file.attribute(key, value)
        for name in names:
            dataset = old[name]
            if dataset.axis < 0:
                value = dataset[()]
                file.small(name, value.decode() if isinstance(value, bytes) else value, gaps=True)
            else:
                part = slice(*row_range(comm, dataset.shape[dataset.axis]))
                file.rows(name, dataset[(slice(None),) * dataset.axis + (part,)], axis=dataset.axis)
        write_stress(file, stress)
