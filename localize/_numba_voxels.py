"""Kernels of the voxel map: a hash table of cells, each with the mean, scatter and shape of the points that fell in."""

import numpy as np
from numba import njit

from localize._numba_eigen import eigen3

EMPTY = np.int64(-1)
COUNT, MEAN, ROWS, VARIANCE, SCALE, AXES, SCATTER, CELL = 0, 1, 4, 5, 6, 9, 18, 24
"""Columns of a cell: how many points, their mean (3), the kind of shape, variance across it, scale (3), axes (3 by 3)
and scatter (6). They stand side by side, so that a cell is fetched from memory once."""
PLANES, PLANES_AND_EDGES, EDGES = 0, 1, 2
_PLANE_RATIO, _EDGE_RATIO = 0.37, 2.1  # paper 002, Eq. 30
_ROCK_VARIANCE, _ROCK_POINTS = 0.02**2, 10
"""How rough rock is taken to be [m²] until this many points have told: between a few scan lines anything may be."""
_SHARED = 3.0
"""Points that came with one scan share the error of its pose: so many count as one for how a normal leans."""
_BEYOND = 6.0
"""How far from its points a shape is believed, as the square of their standard deviations: 6 is the corner of an evenly
filled square. Beyond it rock bends; and where a robot that moves off sees the floor line by line, slopes drawn out to
the next line would carry one error on and on."""
_STRIDE = 0.2
"""Of a cell: how closely a way is looked at."""
_GRAZING = 0.05
"""Sine of the angle below which a way along rock is not one through it."""
_BIAS = 1 << 20  # cells are numbered from -2^20 to 2^20 on each axis


@njit(cache=True, inline="always")
def cell_key(x, y, z, inverse_size):
    """The cell of a point as one number."""
    i = np.int64(np.floor(x * inverse_size)) + _BIAS
    j = np.int64(np.floor(y * inverse_size)) + _BIAS
    k = np.int64(np.floor(z * inverse_size)) + _BIAS
    return (i << 42) | (j << 21) | k


@njit(cache=True, inline="always")
def slot_of(table, key):
    """Where a key stands in the table (n, 2) of keys and their cells, or where it would be put."""
    mask = np.uint64(len(table) - 1)
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(32))) & mask
    while table[np.int64(h), 0] != EMPTY and table[np.int64(h), 0] != key:
        h = (h + np.uint64(1)) & mask
    return np.int64(h)


@njit(cache=True)
def rehash(table, new_table):
    """The table again in a larger one."""
    for s in range(len(table)):
        if table[s, 0] != EMPTY:
            new_table[slot_of(new_table, table[s, 0])] = table[s]


@njit(cache=True)
def insert(points, R, p, inverse_size, max_points, min_points, rule, table, cells, used, added, hit, centre, A, new):
    """Add points (n, 3), at ``R x + p`` in the map; returns how many cells are in use.

    Full cells (max_points) stay as they are. The tables must have room for n more cells. The shape of a cell is that
    of its points: rows is 0 while it has none, 1 for a plane, 2 for an edge; axes are its eigenvectors by ascending
    spread, the first ``rows`` of them across the shape, scale is one over the spread along each, variance that across
    [m²]. A, new (6, 6): what the cells that were hit tell of the place of the map, turned about ``centre`` (3,) and
    moved, in its axes; and as much of it as came with these points, with all that the noise of the normals pretends to
    tell. added and hit are scratch; added must be 0.
    """
    hits = 0
    for i in range(len(points)):
        x = R[0, 0] * points[i, 0] + R[0, 1] * points[i, 1] + R[0, 2] * points[i, 2] + p[0]
        y = R[1, 0] * points[i, 0] + R[1, 1] * points[i, 1] + R[1, 2] * points[i, 2] + p[1]
        z = R[2, 0] * points[i, 0] + R[2, 1] * points[i, 1] + R[2, 2] * points[i, 2] + p[2]
        key = cell_key(x, y, z, inverse_size)
        slot = slot_of(table, key)
        if table[slot, 0] == EMPTY:
            table[slot, 0] = key
            table[slot, 1] = used
            cells[used] = 0.0
            used += 1
        c = table[slot, 1]
        if added[c] == 0:
            hit[hits] = c
            hits += 1
        cell = cells[c]
        n = cell[COUNT]
        if n >= max_points:
            if added[c] == 0:
                added[c] = -1
            continue
        added[c] = max(added[c], 0) + 1
        n += 1.0
        cell[COUNT] = n
        dx, dy, dz = x - cell[MEAN], y - cell[MEAN + 1], z - cell[MEAN + 2]
        cell[MEAN] += dx / n
        cell[MEAN + 1] += dy / n
        cell[MEAN + 2] += dz / n
        ex, ey, ez = x - cell[MEAN], y - cell[MEAN + 1], z - cell[MEAN + 2]
        cell[SCATTER] += dx * ex
        cell[SCATTER + 1] += dx * ey
        cell[SCATTER + 2] += dx * ez
        cell[SCATTER + 3] += dy * ey
        cell[SCATTER + 4] += dy * ez
        cell[SCATTER + 5] += dz * ez
    A[:, :] = 0.0
    new[:, :] = 0.0
    row = np.empty((1, 6))
    for k in range(hits):
        cell, came = cells[hit[k]], max(added[hit[k]], 0)
        added[hit[k]] = 0
        if came > 0 and cell[COUNT] >= min_points:
            _fit(cell, rule)
        if cell[ROWS] > 0.0:
            _put_knowledge(cell, came / cell[COUNT], centre, row, A, new)
    for i in range(6):
        for j in range(i):
            A[i, j], new[i, j] = A[j, i], new[j, i]
    return used


@njit(cache=True)
def _fit(cell, rule):
    """The shape of a cell from its points."""
    S, spread, axes = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    n, scatter = cell[COUNT], cell[SCATTER:CELL]
    S[0, 0], S[0, 1], S[0, 2] = scatter[0], scatter[1], scatter[2]
    S[1, 0], S[1, 1], S[1, 2] = scatter[1], scatter[3], scatter[4]
    S[2, 0], S[2, 1], S[2, 2] = scatter[2], scatter[4], scatter[5]
    eigen3(S, spread, axes)
    spread /= n - 1
    rows = _shape(spread, rule)
    across = 0.0
    for j in range(3):
        cell[SCALE + j] = 1.0 / np.sqrt(max(spread[j], 1e-12))
        for k in range(3):
            cell[AXES + 3 * j + k] = axes[j, k]
        if j < rows:
            across += max(spread[j], 0.0) / rows
    cell[ROWS] = rows
    cell[VARIANCE] = (across * (n - 1) + _ROCK_POINTS * _ROCK_VARIANCE) / (n - 3 + _ROCK_POINTS)


@njit(cache=True, inline="always")
def _shape(spread, rule):
    """1 for a plane, 2 for an edge, 0 for neither, by the variances (3,) of the points, ascending."""
    if rule == PLANES:
        # a plane spreads both ways: a single scan line has no normal
        return 1 if spread[1] > 9.0 * spread[0] and spread[1] > 0.05 * spread[2] else 0
    ratio = (spread[2] - spread[1]) / max(spread[1] - spread[0], 1e-12)
    if rule == PLANES_AND_EDGES and ratio <= _PLANE_RATIO:
        return 1
    return 2 if ratio >= _EDGE_RATIO else 0


@njit(cache=True)
def downsample(points, inverse_size, table, total, out):
    """Mean of the points (n, 3) in each cell into out; returns how many. table and total are scratch."""
    table[:, 0] = EMPTY
    m = 0
    for i in range(len(points)):
        key = cell_key(points[i, 0], points[i, 1], points[i, 2], inverse_size)
        slot = slot_of(table, key)
        if table[slot, 0] == EMPTY:
            table[slot, 0] = key
            table[slot, 1] = m
            out[m] = 0.0
            total[m] = 0
            m += 1
        c = table[slot, 1]
        for k in range(3):
            out[c, k] += points[i, k]
        total[c] += 1
    for c in range(m):
        out[c] /= total[c]
    return m


@njit(cache=True)
def crosses(begin, end, first, last, size, table, cells, hit):
    """hit (n,): whether the straight way from begin to end (n, 3) goes through a plane, from ``first`` (n,) to ``last``
    (n,) of it [m]."""
    for i in range(len(begin)):
        way = end[i] - begin[i]
        way /= max(np.sqrt(np.sum(way**2)), 1e-9)
        hit[i] = _crosses(begin[i], way, first[i], last[i], size, table, cells)


@njit(cache=True)
def _crosses(begin, way, first, last, size, table, cells):
    for step in range(max(int((last - first) / (_STRIDE * size)) + 1, 0)):
        at = first + _STRIDE * size * step
        key = cell_key(begin[0] + at * way[0], begin[1] + at * way[1], begin[2] + at * way[2], 1.0 / size)
        slot = slot_of(table, key)
        if table[slot, 0] == EMPTY:
            continue
        cell = cells[table[slot, 1]]
        if cell[ROWS] != 1.0:
            continue
        u, v, w = cell[AXES : AXES + 3], cell[AXES + 3 : AXES + 6], cell[AXES + 6 : AXES + 9]
        slope = u[0] * way[0] + u[1] * way[1] + u[2] * way[2]
        if abs(slope) < _GRAZING:
            continue
        x, y, z = begin[0] - cell[MEAN], begin[1] - cell[MEAN + 1], begin[2] - cell[MEAN + 2]
        meets = -(u[0] * x + u[1] * y + u[2] * z) / slope
        x, y, z = x + meets * way[0], y + meets * way[1], z + meets * way[2]
        off2 = (cell[SCALE + 1] * (v[0] * x + v[1] * y + v[2] * z)) ** 2
        off2 += (cell[SCALE + 2] * (w[0] * x + w[1] * y + w[2] * z)) ** 2
        if first <= meets <= last and off2 < _BEYOND:
            return True
    return False


@njit(cache=True, inline="always")
def _shape_near(x, y, z, size, table, cells):
    """The cell whose shape a point belongs to: its own, or of the six beside it the one with the nearest mean."""
    inverse_size = 1.0 / size
    own = slot_of(table, cell_key(x, y, z, inverse_size))
    if table[own, 0] != EMPTY and cells[table[own, 1], ROWS] > 0.0:
        return table[own, 1]
    best, best_distance2 = np.int64(-1), size * size
    for axis in range(3):
        for sign in (-1.0, 1.0):
            qx, qy, qz = x, y, z
            if axis == 0:
                qx += sign * size
            elif axis == 1:
                qy += sign * size
            else:
                qz += sign * size
            slot = slot_of(table, cell_key(qx, qy, qz, inverse_size))
            if table[slot, 0] == EMPTY:
                continue
            c = table[slot, 1]
            if cells[c, ROWS] == 0.0:
                continue
            distance2 = (x - cells[c, MEAN]) ** 2 + (y - cells[c, MEAN + 1]) ** 2 + (z - cells[c, MEAN + 2]) ** 2
            if distance2 < best_distance2:
                best, best_distance2 = c, distance2
    return best


@njit(cache=True, inline="always")
def _put_row(rows, n, weight, x, y, z, ux, uy, uz):
    """rows[n] (6,): by rotation and position, of a residual along u at a place (x, y, z) from the imu, times weight."""
    rows[n, 0] = weight * (y * uz - z * uy)
    rows[n, 1] = weight * (z * ux - x * uz)
    rows[n, 2] = weight * (x * uy - y * ux)
    rows[n, 3], rows[n, 4], rows[n, 5] = weight * ux, weight * uy, weight * uz


@njit(cache=True, inline="always")
def _leaning(cell, weight):
    """By how much a shape leans by the noise of its points alone, if they spread by 1: noise / √n; times √weight."""
    n = cell[COUNT]
    # what the points told themselves, without the roughness taken for granted
    noise = max(cell[VARIANCE] * (n - 3 + _ROCK_POINTS) - _ROCK_POINTS * _ROCK_VARIANCE, 0.0) / (n - 3)
    return np.sqrt(weight * noise * _SHARED / n)


@njit(cache=True)
def _put_knowledge(cell, share, centre, row, A, new):
    """Adds what a shape tells to the upper half of A, and what is new of it to that of new; row (1, 6) is scratch."""
    x, y, z = cell[MEAN] - centre[0], cell[MEAN + 1] - centre[1], cell[MEAN + 2] - centre[2]
    weight, across = 1.0 / cell[VARIANCE], int(cell[ROWS])
    # an old shape leans by chance as a new one does: nothing is known of that
    leaning = (1.0 - share) * _leaning(cell, weight) ** 2
    for k in range(3):
        ux, uy, uz = cell[AXES + 3 * k], cell[AXES + 3 * k + 1], cell[AXES + 3 * k + 2]
        _put_row(row, 0, 1.0, x, y, z, ux, uy, uz)
        told = weight if k < across else 0.0
        fresh = share * weight if k < across else leaning * cell[SCALE + k] ** 2
        for i in range(6):
            for j in range(i, 6):
                square = row[0, i] * row[0, j]
                A[i, j] += told * square
                new[i, j] += fresh * square


@njit(cache=True, inline="always")
def _gram(rows, n, R, out):
    """``Σ hᵀh`` of the first n rows h (6,) in the axes of the map, into out (6, 6) in those of the imu."""
    total = np.zeros((6, 6))
    for k in range(n):
        for i in range(6):
            for j in range(i, 6):
                total[i, j] += rows[k, i] * rows[k, j]
    for i in range(6):
        for j in range(i):
            total[i, j] = total[j, i]
    for i in (0, 3):
        for j in (0, 3):
            out[i : i + 3, j : j + 3] = R.T @ np.ascontiguousarray(total[i : i + 3, j : j + 3]) @ R


@njit(cache=True)
def point_to_shape(
    points, R, p, R_imu_lidar, p_imu_lidar, size, table, cells, range_variance, beam_variance, gate,
    mark, met, pulls, rows, A, b, B, C, residuals, sigmas,
):  # fmt: skip
    """A = Σ HᵀH/σ², b = -Σ Hᵀr/σ² of the residuals ``uᵀ(T p - mean)`` (paper 000 Eq. 14); returns how many matched.

    Across a plane there is one u, across an edge there are two (paper 002 Eq. 31). σ² is what one point errs by alone
    and what the shape errs by, which every point on it shares: B is the covariance of b that comes from the shapes,
    ``Σ (Σ hᵀ/σ²)(Σ h/σ²) σ_shape²``, the inner sums over the points of one shape. C is what of A to expect from
    noise alone: a normal that leans by chance looks along directions of which the true one knows nothing.
    points (n, 3) in the lidar frame; R, p: the imu in the map; columns of H: rotation and position of the imu, in its
    own axes. residuals, sigmas (n, 2) [m]: NaN where there is none. mark (cells) must be 0 and pulls (2 n, 8),
    rows (2 n, 6) and met (n,) are scratch.
    """
    b[:] = 0.0
    o = R @ p_imu_lidar
    R_map_lidar = R @ R_imu_lidar
    matched, shapes, used = 0, 0, 0
    for i in range(len(points)):
        residuals[i] = np.nan
        sigmas[i] = np.nan
        # from the lidar, from the imu, and in the map
        rx = R_map_lidar[0, 0] * points[i, 0] + R_map_lidar[0, 1] * points[i, 1] + R_map_lidar[0, 2] * points[i, 2]
        ry = R_map_lidar[1, 0] * points[i, 0] + R_map_lidar[1, 1] * points[i, 1] + R_map_lidar[1, 2] * points[i, 2]
        rz = R_map_lidar[2, 0] * points[i, 0] + R_map_lidar[2, 1] * points[i, 1] + R_map_lidar[2, 2] * points[i, 2]
        ix, iy, iz = rx + o[0], ry + o[1], rz + o[2]
        x, y, z = ix + p[0], iy + p[1], iz + p[2]
        c = _shape_near(x, y, z, size, table, cells)
        if c < 0:
            continue
        cell = cells[c]
        across = int(cell[ROWS])
        dx, dy, dz = x - cell[MEAN], y - cell[MEAN + 1], z - cell[MEAN + 2]
        # the shape is known best amid its points, and the less the farther beyond them; far beyond, nothing is known
        beyond = 0.0
        for k in range(across, 3):
            along = cell[AXES + 3 * k] * dx + cell[AXES + 3 * k + 1] * dy + cell[AXES + 3 * k + 2] * dz
            beyond += (cell[SCALE + k] * along) ** 2
        if beyond > _BEYOND:
            continue
        range2 = rx * rx + ry * ry + rz * rz
        first = used
        for k in range(across):
            ux, uy, uz = cell[AXES + 3 * k], cell[AXES + 3 * k + 1], cell[AXES + 3 * k + 2]
            r = ux * dx + uy * dy + uz * dz
            # a range errs along its ray, its direction across it
            along2 = (ux * rx + uy * ry + uz * rz) ** 2
            alone2 = cell[VARIANCE] + range_variance * along2 / range2 + beam_variance * (range2 - along2)
            shape2 = alone2 * (1.0 + beyond) / cell[COUNT]
            sigma2 = alone2 + shape2
            if r * r > gate * gate * sigma2:
                continue
            # Cauchy weight: a stone or a vehicle that was not there must not pull
            weight = 1.0 / (sigma2 + 0.25 * r * r)
            if mark[c] == 0:
                shapes += 1
                mark[c] = shapes
                met[shapes - 1] = c
                pulls[2 * shapes - 2 : 2 * shapes] = 0.0
            s, scale = 2 * (mark[c] - 1) + k, np.sqrt(weight)
            _put_row(rows, used, scale, ix, iy, iz, ux, uy, uz)
            for j in range(6):
                pulls[s, j] += scale * rows[used, j]
                b[j] -= scale * r * rows[used, j]
            # by how much a shape is off where the points met it, in the mean weighted as they are
            pulls[s, 6] += weight * shape2
            pulls[s, 7] += weight
            residuals[i, k] = r
            sigmas[i, k] = np.sqrt(sigma2)
            used += 1
        if used > first:
            matched += 1
    _gram(rows, used, R, A)
    b[:3], b[3:] = b[:3] @ R, b[3:] @ R
    leaning = 0
    for k in range(2 * shapes):
        weight = pulls[k, 7]
        scale = np.sqrt(pulls[k, 6] / weight) if weight > 0.0 else 0.0
        for j in range(6):
            rows[k, j] = scale * pulls[k, j]
    _gram(rows, 2 * shapes, R, B)
    for k in range(shapes):
        c = met[k]
        cell = cells[c]
        mark[c] = 0
        noise = _leaning(cell, pulls[2 * k, 7] + pulls[2 * k + 1, 7])
        dx, dy, dz = cell[MEAN] - p[0], cell[MEAN + 1] - p[1], cell[MEAN + 2] - p[2]
        for j in range(int(cell[ROWS]), 3):
            ux, uy, uz = cell[AXES + 3 * j], cell[AXES + 3 * j + 1], cell[AXES + 3 * j + 2]
            _put_row(rows, leaning, noise * cell[SCALE + j], dx, dy, dz, ux, uy, uz)
            leaning += 1
    _gram(rows, leaning, R, C)
    return matched
