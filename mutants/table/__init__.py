"""The mutations, a file for each room of the package.

A text stands exactly once in its file. Tests are files or ids below tests/, separated by blanks: the fewer, the faster.
"""

from mutants.mutation import Mutation
from mutants.table import critics, data, evaluation, exporting, learners, learning, methods, plots, reproduce, tasks

_ROOMS = [learning, learners, critics, methods, data, evaluation, tasks, exporting, reproduce, plots]
MUTATIONS = [
    Mutation(file, *mutation) for room in _ROOMS for file, mutations in room.TABLE.items() for mutation in mutations
]
