"""Cases made by rule, run through the command line, and judged: `make fuzz`.

A case is a folder of files and one command. Its verdict is one of four:

right           The command succeeds, and the numbers in the file that it wrote are those of a second reading that owes
                nothing to hpcred: of texts the strict readers of `readings`, `node_readings`, of arrays (.npz, PETSc,
                MATLAB 7.3) numpy, struct and h5py beside the rules of the formats, of tables tomllib beside the types
                of the dataclasses, of other binary files the numbers of the undamaged file.
refused         Exit status 1 or 2, `hpcred: error:` and one sentence in one line, nothing else but warnings, no file
                written, changed or left behind.
internal error  Anything else that ends: a traceback, an `internal error`, lines of a library, a crash, a hang.
wrong           Success with other numbers, or where the second reading says that the input means nothing; files changed
                that were read; also a good file (made by the grammar, not damaged) that is refused.

Damage can turn a file into another good one: a digit of a value in a text without checksum. There the second reading
reads the damaged text, and `right` is what that text says. A text that the second reading cannot read must be refused.
Other binary files have no second reading: there the places where damage makes another good file (values, coordinates,
padding) are left out, and `right` is what the undamaged file says. In HDF5 files of hpcred nothing is left out.
"""
