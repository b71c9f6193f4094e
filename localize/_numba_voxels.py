"""Kernels of the voxel map: a hash table of cells, each with the mean, scatter and shape of the points that fell in."""

import numpy as np
from numba import njit

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
def eigen3(S, values, vectors):
    """Eigenvalues (3,), ascending, and eigenvectors (rows of (3, 3)) of a symmetric matrix (3, 3), which is used up.

    Jacobi's rotations: several times faster here than LAPACK, and the same to the last bit on every processor.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    size = S[0, 0] + S[1, 1] + S[2, 2]
    for _ in range(12):
        if S[0, 1] ** 2 + S[0, 2] ** 2 + S[1, 2] ** 2 <= (1e-14 * size) ** 2:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if S[p, q] == 0.0:
                    continue
                theta = (S[q, q] - S[p, p]) / (2.0 * S[p, q])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                cos = 1.0 / np.sqrt(t * t + 1.0)
                sin = t * cos
                for k in range(3):
                    a, b = S[k, p], S[k, q]
                    S[k, p], S[k, q] = cos * a - sin * b, sin * a + cos * b
                for k in range(3):
                    a, b = S[p, k], S[q, k]
                    S[p, k], S[q, k] = cos * a - sin * b, sin * a + cos * b
                for k in range(3):
                    a, b = vectors[p, k], vectors[q, k]
                    vectors[p, k], vectors[q, k] = cos * a - sin * b, sin * a + cos * b
    for i in range(3):
        values[i] = S[i, i]
    for i in range(2):
        for j in range(2 - i):
            if values[j] > values[j + 1]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    vectors[j, k], vectors[j + 1, k] = vectors[j + 1, k], vectors[j, k]


@njit(cache=True)
def insert(points, inverse_size, max_points, min_points, rule, table, cells, used, added, hit):
    """Add points (n, 3) in the map; returns the number of cells in use and how new the map is where the points are.

    Full cells (max_points) stay as they are. The tables must have room for n more cells. The shape of a cell is that
    of its points: rows is 0 while it has none, 1 for a plane, 2 for an edge; axes are its eigenvectors by ascending
    spread, the first ``rows`` of them across the shape, scale is one over the spread along each, variance that across
    [m²]. added and hit are scratch; added must be 0.
    """
    hits = 0
    for i in range(len(points)):
        key = cell_key(points[i, 0], points[i, 1], points[i, 2], inverse_size)
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
        dx, dy, dz = points[i, 0] - cell[MEAN], points[i, 1] - cell[MEAN + 1], points[i, 2] - cell[MEAN + 2]
        cell[MEAN] += dx / n
        cell[MEAN + 1] += dy / n
        cell[MEAN + 2] += dz / n
        ex, ey, ez = points[i, 0] - cell[MEAN], points[i, 1] - cell[MEAN + 1], points[i, 2] - cell[MEAN + 2]
        cell[SCATTER] += dx * ex
        cell[SCATTER + 1] += dx * ey
        cell[SCATTER + 2] += dx * ez
        cell[SCATTER + 3] += dy * ey
        cell[SCATTER + 4] += dy * ez
        cell[SCATTER + 5] += dz * ez
    share, shapes = 0.0, 0
    for k in range(hits):
        c = hit[k]
        if added[c] > 0 and cells[c, COUNT] >= min_points:
            _fit(cells[c], rule)
        if cells[c, ROWS] > 0.0:
            share += max(added[c], 0) / cells[c, COUNT]
            shapes += 1
        added[c] = 0
    return used, (share / shapes if shapes else 1.0)


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
def _add_leaning(cell, weight, R, p, h, C):
    """Add to C what the noise of a shape's points alone would give: across leans along by noise / (√n spread)."""
    n = cell[COUNT]
    # what the points told themselves, without the roughness taken for granted
    noise = max(cell[VARIANCE] * (n - 3 + _ROCK_POINTS) - _ROCK_POINTS * _ROCK_VARIANCE, 0.0) / (n - 3)
    dx, dy, dz = cell[MEAN] - p[0], cell[MEAN + 1] - p[1], cell[MEAN + 2] - p[2]
    ix = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    iy = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    iz = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    for k in range(int(cell[ROWS]), 3):
        ux, uy, uz = cell[AXES + 3 * k], cell[AXES + 3 * k + 1], cell[AXES + 3 * k + 2]
        mx = R[0, 0] * ux + R[1, 0] * uy + R[2, 0] * uz
        my = R[0, 1] * ux + R[1, 1] * uy + R[2, 1] * uz
        mz = R[0, 2] * ux + R[1, 2] * uy + R[2, 2] * uz
        h[0], h[1], h[2] = iy * mz - iz * my, iz * mx - ix * mz, ix * my - iy * mx
        h[3], h[4], h[5] = mx, my, mz
        leaning = weight * noise * cell[SCALE + k] * cell[SCALE + k] * _SHARED / n
        for row in range(6):
            for column in range(row, 6):
                C[row, column] += leaning * h[row] * h[column]


@njit(cache=True)
def point_to_shape(
    points, R, p, R_imu_lidar, p_imu_lidar, size, table, cells, range_variance, beam_variance, gate,
    mark, met, pulls, A, b, B, C, residuals, sigmas,
):  # fmt: skip
    """Sum A += HᵀH/σ², b -= Hᵀr/σ² of the residuals ``uᵀ(T p - mean)`` (paper 000 Eq. 14); returns how many matched.

    Across a plane there is one u, across an edge there are two (paper 002 Eq. 31). σ² is what one point errs by alone
    and what the shape errs by, which every point on it shares: B is the covariance of b that comes from the shapes,
    ``Σ (Σ hᵀ/σ²)(Σ h/σ²) σ_shape²``, the inner sums over the points of one shape. C is what of A to expect from
    noise alone: a normal that leans by chance looks along directions of which the true one knows nothing.
    points (n, 3) in the lidar frame; R, p: the imu in the map; columns of H: rotation and position of the imu, in its
    own axes. residuals, sigmas (n, 2) [m]: NaN where there is none. mark (cells) must be 0 and pulls
    (2 n, 8) and met (n,) are scratch.
    """
    A[:, :] = 0.0
    b[:] = 0.0
    B[:, :] = 0.0
    C[:, :] = 0.0
    h = np.empty(6)
    ox = R[0, 0] * p_imu_lidar[0] + R[0, 1] * p_imu_lidar[1] + R[0, 2] * p_imu_lidar[2] + p[0]
    oy = R[1, 0] * p_imu_lidar[0] + R[1, 1] * p_imu_lidar[1] + R[1, 2] * p_imu_lidar[2] + p[1]
    oz = R[2, 0] * p_imu_lidar[0] + R[2, 1] * p_imu_lidar[1] + R[2, 2] * p_imu_lidar[2] + p[2]
    matched, shapes = 0, 0
    for i in range(len(points)):
        residuals[i] = np.nan
        sigmas[i] = np.nan
        lx, ly, lz = points[i, 0], points[i, 1], points[i, 2]
        ix = R_imu_lidar[0, 0] * lx + R_imu_lidar[0, 1] * ly + R_imu_lidar[0, 2] * lz + p_imu_lidar[0]
        iy = R_imu_lidar[1, 0] * lx + R_imu_lidar[1, 1] * ly + R_imu_lidar[1, 2] * lz + p_imu_lidar[1]
        iz = R_imu_lidar[2, 0] * lx + R_imu_lidar[2, 1] * ly + R_imu_lidar[2, 2] * lz + p_imu_lidar[2]
        x = R[0, 0] * ix + R[0, 1] * iy + R[0, 2] * iz + p[0]
        y = R[1, 0] * ix + R[1, 1] * iy + R[1, 2] * iz + p[1]
        z = R[2, 0] * ix + R[2, 1] * iy + R[2, 2] * iz + p[2]
        c = _shape_near(x, y, z, size, table, cells)
        if c < 0:
            continue
        cell = cells[c]
        rows = int(cell[ROWS])
        dx, dy, dz = x - cell[MEAN], y - cell[MEAN + 1], z - cell[MEAN + 2]
        # the shape is known best amid its points, and the less the farther beyond them; far beyond, nothing is known
        beyond = 0.0
        for k in range(rows, 3):
            along = cell[AXES + 3 * k] * dx + cell[AXES + 3 * k + 1] * dy + cell[AXES + 3 * k + 2] * dz
            beyond += (cell[SCALE + k] * along) ** 2
        if beyond > _BEYOND:
            continue
        rx, ry, rz = x - ox, y - oy, z - oz
        range2 = rx * rx + ry * ry + rz * rz
        used = False
        for k in range(rows):
            nx, ny, nz = cell[AXES + 3 * k], cell[AXES + 3 * k + 1], cell[AXES + 3 * k + 2]
            r = nx * dx + ny * dy + nz * dz
            # a range errs along its ray, its direction across it
            along2 = (nx * rx + ny * ry + nz * rz) ** 2
            alone2 = cell[VARIANCE] + range_variance * along2 / range2 + beam_variance * (range2 - along2)
            shape2 = alone2 * (1.0 + beyond) / cell[COUNT]
            sigma2 = alone2 + shape2
            if r * r > gate * gate * sigma2:
                continue
            # normal in the imu frame
            mx = R[0, 0] * nx + R[1, 0] * ny + R[2, 0] * nz
            my = R[0, 1] * nx + R[1, 1] * ny + R[2, 1] * nz
            mz = R[0, 2] * nx + R[1, 2] * ny + R[2, 2] * nz
            h[0], h[1], h[2] = iy * mz - iz * my, iz * mx - ix * mz, ix * my - iy * mx
            h[3], h[4], h[5] = mx, my, mz
            # Cauchy weight: a stone or a vehicle that was not there must not pull
            weight = 1.0 / (sigma2 * (1.0 + r * r / (4.0 * sigma2)))
            if mark[c] == 0:
                shapes += 1
                mark[c] = shapes
                met[shapes - 1] = c
                pulls[2 * shapes - 2 : 2 * shapes] = 0.0
            pull = pulls[2 * (mark[c] - 1) + k]
            for row in range(6):
                hw = h[row] * weight
                b[row] -= hw * r
                pull[row] += hw
                for column in range(row, 6):
                    A[row, column] += hw * h[column]
            # by how much a shape is off where the points met it, in the mean weighted as they are
            pull[6] += weight * shape2
            pull[7] += weight
            residuals[i, k] = r
            sigmas[i, k] = np.sqrt(sigma2)
            used = True
        if used:
            matched += 1
    for k in range(2 * shapes):
        if pulls[k, 7] > 0.0:
            shape2 = pulls[k, 6] / pulls[k, 7]
            for row in range(6):
                for column in range(row, 6):
                    B[row, column] += pulls[k, row] * pulls[k, column] * shape2
    for k in range(shapes):
        c = met[k]
        mark[c] = 0
        _add_leaning(cells[c], pulls[2 * k, 7] + pulls[2 * k + 1, 7], R, p, h, C)
    for row in range(6):
        for column in range(row):
            A[row, column] = A[column, row]
            B[row, column] = B[column, row]
            C[row, column] = C[column, row]
    return matched


@njit(cache=True)
def beyond_noise(A, b, B, C, blind_from, blind):
    """A (6, 6), b (6,) and B (6, 6) of `point_to_shape` without what C explains, in place; see `localize.lidar`.

    Rotation and position each for themselves: along a direction in which a share γ of A comes from C, b is multiplied
    by ``1 - γ``, and A and B by its square; by 0 where γ is ``blind_from`` and more. blind (6, 6): unit columns along
    these; the other columns are 0.
    """
    T, W, share, V = np.zeros((6, 6)), np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    blind[:, :] = 0.0
    for first in (0, 3):
        block = slice(first, first + 3)
        # whitened by A: W A Wᵀ = 1, rows of W
        eigen3(A[block, block].copy(), share, W)
        least = 1e-9 * (share[0] + share[1] + share[2])
        for i in range(3):
            W[i] /= np.sqrt(max(share[i], least))
        eigen3(W @ np.ascontiguousarray(C[block, block]) @ W.T, share, V)
        directions = V @ W
        known = directions @ np.ascontiguousarray(A[block, block])
        for i in range(3):
            left = 1.0 - share[i] if share[i] < blind_from else 0.0
            for row in range(3):
                for column in range(3):
                    T[first + row, first + column] += left * known[i, row] * directions[i, column]
            if left == 0.0:
                blind[block, first + i] = directions[i] / np.sqrt(np.sum(directions[i] ** 2))
    A[:, :] = T @ A @ T.T
    b[:] = T @ b
    B[:, :] = T @ B @ T.T
