"""Assignment of rows to columns by the least sum of costs."""

from collections.abc import Iterator

import numpy as np

from reconstruction.common.geometry import Array


def assign(costs: Array, limit: float) -> Iterator[tuple[int, int]]:
    """Yield (row, column) of the pairs below `limit` whose costs (rows, columns), with `limit` for each row
    that has none, sum up to the least.

    The Hungarian method by shortest augmenting paths (Jonker and Volgenant 1987).
    """
    rows, columns = costs.shape
    # Each row may also stay alone, in a column of its own.
    table = np.full((rows, columns + rows), limit)
    table[:, :columns] = np.minimum(costs, 4 * limit)
    of_row, of_column = np.zeros(rows), np.zeros(columns + rows)
    owner = np.full(columns + rows, -1)
    for begin in range(rows):
        shortest, before = np.full(columns + rows, np.inf), np.full(columns + rows, -1)
        done = np.zeros(columns + rows, bool)
        row, reached, column = begin, 0.0, -1
        while row >= 0:
            reduced = reached + table[row] - of_row[row] - of_column
            nearer = ~done & (reduced < shortest)
            shortest[nearer], before[nearer] = reduced[nearer], column
            column = int(np.where(done, np.inf, shortest).argmin())
            reached, row = float(shortest[column]), int(owner[column])
            done[column] = True
        others = done & (owner >= 0)
        of_row[owner[others]] += reached - shortest[others]
        of_row[begin] += reached
        of_column[done] -= reached - shortest[done]
        while column >= 0:
            previous = int(before[column])
            owner[column] = owner[previous] if previous >= 0 else begin
            column = previous
    for place, own in enumerate(owner[:columns].tolist()):
        if own >= 0 and costs[own, place] < limit:
            yield own, place
