"""Put reduced bodies together, linearly, with joints; small matrices, local, without PETSc."""
