"""Read models from lines of words and numbers, and write bodies as small texts; the documentation quotes both."""

import numpy as np
from scipy.sparse import coo_array

import hpcred


# --8<-- [start:reader]
class Springs(hpcred.readers.Reader):
    """Lines such as "node 1 0.5 0 0" and, of both triangles, "K 1 1 2 1 -3e5": node, direction, twice, and a value."""

    name = "springs"
    told_by = "its first line, %springs"

    def begins(self, start):
        return start.startswith(b"%springs")

    def read_model(self, path, comm):
        K = M = nodes = dofs = None
        with hpcred.agreed(comm):  # an error of one rank is that of all
            if comm.rank == 0:  # the other ranks give nothing; those of a large file read shares
                nodes, dofs, K, M = self.read(path)
        return hpcred.readers.Parts.from_arrays(path, comm, K, M, nodes=nodes, dofs=dofs)

    def read(self, path):
        rows = {"node": [], "K": [], "M": []}
        with open(path) as file:
            for number, line in enumerate(file, 1):
                word, *values = line.split() or [""]
                if word in rows:
                    rows[word].append([float(value) for value in values])
                elif number > 1:
                    raise hpcred.InputError(f"{path}: line {number}: found '{word}', expected node, K or M")
        ends = np.array([entry[:2] for entry in rows["K"]], int)
        dofs = np.unique(ends, axis=0)
        place = {tuple(dof): k for k, dof in enumerate(dofs.tolist())}
        matrices = []
        for key in "KM":
            i, j = ([place[tuple(entry[k : k + 2])] for entry in rows[key]] for k in (0, 2))
            matrices.append(coo_array(([entry[4] for entry in rows[key]], (i, j)), shape=[len(dofs)] * 2))
        return rows["node"], dofs, *matrices
# --8<-- [end:reader]


# --8<-- [start:writer]
class Flexible(hpcred.writers.Writer):
    """Mass, stiffness and mass matrix of a body as text, with its interface nodes in a second file."""

    suffix = ".flex"
    needs = "body"

    def begins(self, start):
        return start.startswith(b"%flexible")

    def write(self, target, source):
        body = source.body
        with open(target, "w") as file:
            file.write(f"%flexible {source.name}, mass {body.floating_frame.mass:.16g} in {source.units.name}\n")
            np.savetxt(file, np.concatenate([body.reduced.K, body.reduced.M]))
        lines = [f"{shape.node} {shape.position[0]} {shape.position[1]} {shape.position[2]}" for shape in body.nodes]
        source.beside["_nodes.flex"] = "\n".join(["%flexible nodes", *lines, ""])
        return ["inputs, outputs and damping are left out"]

    def describe(self, path):
        with open(path) as file:
            return {"about": file.readline().removeprefix("%flexible ").strip()}
# --8<-- [end:writer]
