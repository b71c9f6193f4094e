"""Where odom lies in the map, from UWB ranges or prism fixes alone, in motion, with no first guess.

Gravity is known, so four numbers are sought: heading and translation (paper 000, LIU mode: alignment with G).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from semmap.geometry import Array, se3, yaw_rotation

Hidden = Callable[[Array, Array], NDArray[np.bool_]]
"""Between which tags and anchors (n, 3) there is rock (n,)."""
_STARTS = 12
"""Headings from which the ranges' solver starts."""
_STEPS = 60
_HUBER = 1.5
_MISFIT = 3.0
"""A range that is off by more sigmas is an outlier."""
_BAD_PART = 0.3
"""More outliers than this and the solution is not believed."""
_STEPS_OF_CLOCK = 3
_FITS = 3
"""Fits, each without what the one before did not explain."""
_SOME_PART = 0.25
"""With fewer ranges that fit nothing is made better by leaving out the others."""
_AS_WELL = 0.5
"""A place that fits worse by less than this share, and by less than ten, fits as well."""
_REDUNDANT = 4
"""So many anchors that fit outvote one that does not."""
_HIDDEN, _CLEARER = 0.5, 0.3
"""A place from which more of the anchors' lines of sight than this pass through rock is none; neither is one of several
that fit from which so many more do than from another."""
_PLAIN_STD = 0.05
"""A place that is known better is known in the first order [m]."""
_TOO_FAR = 2.0
"""Half the square of two sigmas."""
_STRIDE_M, _FARTHEST_M = 0.03, 1.5
_SAME_M = 0.5
_SAME_COS = 0.98
"""Solutions closer than this, at the track's middle and by the cosine of the headings' difference, are one."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """``T_map_level`` (4, 4) of a gravity-levelled odom, with the standard deviation of heading [rad] and place [m].

    bent : unit vector (3,) in the map along which the ranges tell of the place in the second order only, or None: where
    the track lies nearly in the plane of the anchors. ``bent_std`` : how well they do [m].
    clock_offset, clock_std : of the total station [s]: to be added to the stamps of its fixes.
    """

    T_map_level: Array
    yaw_std: float
    position_std: float
    bent: Array | None = None
    bent_std: float = 0.0
    clock_offset: float = 0.0
    clock_std: float = 0.0

    def sure(self, *, yaw_std: float, position_std: float) -> bool:
        """Whether it is known this well."""
        return self.yaw_std < yaw_std and self.position_std < position_std


def align_fixes(
    p_level: Array,
    p_map: Array,
    std: float,
    odometry_std: float = 0.0,
    v_level: Array | None = None,
    clock_std: float = 0.0,
) -> Alignment | None:
    """Heading and translation from points (n, 3) known in both frames; None where they do not fit one another.

    std : of a fix [m]. odometry_std : of the odometry over the stretch, by its own account [m].
    v_level : (n, 3) [m/s] how the points moved, where the clock of the fixes may be off, by ``clock_std`` [s].
    At constant speed nobody can tell that from being farther along.
    """
    if len(p_level) < 3:
        return None
    v_level = np.zeros_like(p_level) if v_level is None else v_level
    for _ in range(_FITS):
        a, b = p_level - p_level.mean(axis=0), p_map - p_map.mean(axis=0)
        spread = float(np.sum(a[:, :2] ** 2))
        if spread == 0.0:
            return None
        # odometry's own error over the stretch comes on top of the instrument's
        noise = std + odometry_std + 0.005 * np.sqrt(spread / len(a))
        offset, offset_std, confused = _clock_offset(a, b, v_level - v_level.mean(axis=0), noise, clock_std)
        a = a + offset * (v_level - v_level.mean(axis=0))
        R = yaw_rotation(_turn_between(a, b))
        off = np.linalg.norm(b - a @ R.T, axis=1)
        if np.median(off) > 4.0 * noise:
            return None
        # something else that shines
        good = off <= 4.0 * max(noise, float(np.median(off)))
        if good.all():
            break
        p_level, p_map, v_level = p_level[good], p_map[good], v_level[good]
    speed = v_level.mean(axis=0)
    T = se3(R, p_map.mean(axis=0) - R @ (p_level.mean(axis=0) + offset * speed))
    # the fixes' noise averages out, odometry's error is one over the stretch
    each, all_alike = std + 0.005 * np.sqrt(spread / len(a)), odometry_std
    yaw_std = (each + all_alike * np.sqrt(len(a))) / np.sqrt(spread)
    by_clock = float(np.linalg.norm(speed)) * offset_std
    return Alignment(
        T, float(np.hypot(yaw_std, confused)), float(np.hypot(each / np.sqrt(len(a)) + all_alike, by_clock)),
        clock_offset=offset, clock_std=offset_std,
    )  # fmt: skip


def _clock_offset(a: Array, b: Array, faster: Array, noise: float, clock_std: float) -> tuple[float, float, float]:
    """What the clock of points ``b`` (n, 3) is off by, their heading to ``a`` (n, 3) being free; both about their mean.

    faster : (n, 3) how much faster than in the mean each moved. Returns the offset, its standard deviation [s], and
    what not knowing it adds to that of the heading [rad].
    """
    if clock_std == 0.0:
        return 0.0, 0.0, 0.0
    offset, weight = 0.0, 1.0 / noise**2
    for _ in range(_STEPS_OF_CLOCK):
        moved = a + offset * faster
        R = yaw_rotation(_turn_between(moved, b))
        H = np.column_stack([np.cross([0.0, 0.0, 1.0], moved @ R.T).ravel(), (faster @ R.T).ravel()])
        A = weight * H.T @ H + np.diag([0.0, 1.0 / clock_std**2])
        rhs = weight * H.T @ (b - moved @ R.T).ravel() - np.array([0.0, offset / clock_std**2])
        offset += float(np.linalg.solve(A, rhs)[1])
    covariance = np.linalg.inv(A)
    return offset, float(np.sqrt(covariance[1, 1])), float(np.sqrt(max(covariance[0, 0] - 1.0 / A[0, 0], 0.0)))


def align_ranges(
    p_level: Array,
    anchors: Array,
    distances: Array,
    std: float,
    bias_std: float = 0.0,
    hidden: Hidden | None = None,
) -> Alignment | None:
    """Heading and translation from ranges (n,) of the tag at ``p_level`` (n, 3) to anchors (n, 3) in the map.

    std : [m] of a range; bias_std : [m] of what an anchor reads too long beside it, which is sought as well.
    hidden : tells of tags (n, 3) and anchors (n, 3), both in level odom, between which of them there is rock. A range
    that fits came straight, so where many of those that fit would have come through rock, the place is not there.
    None where fewer than a good part of the ranges fit, or where a second place fits as well: behind the plane of the
    anchors the track has a mirror image, which only a track that gravity tells from it rules out. Between two places
    very near one another the middle is taken.
    """
    if len(distances) < 12 or len(np.unique(anchors, axis=0)) < 3:
        return None
    middle = p_level.mean(axis=0)
    problem = _Ranges(p_level - middle, anchors, distances, std, bias_std)
    found = problem.solutions()
    costs = [problem.cost(one.x) for one in found]
    limit = min(costs) + _AS_WELL * problem.cost_of_fits(found[int(np.argmin(costs))].x) + 10.0
    as_well = [one for one, cost in zip(found, costs, strict=True) if cost < limit]
    if hidden is not None:
        as_well = _in_sight(as_well, problem, middle, hidden)
    best = min(as_well, key=lambda one: problem.cost(one.x), default=found[0])
    if not as_well or not problem.explained(best.x):
        return None
    apart = max((one.x[1:4] - best.x[1:4] for one in as_well), key=lambda p: float(np.linalg.norm(p)))
    if np.linalg.norm(apart) > _SAME_M or min(np.cos(one.x[0] - best.x[0]) for one in as_well) < _SAME_COS:
        return None
    return _alignment(problem, best, apart, middle)


def _alignment(problem: _Ranges, best: OptimizeResult, apart: Array, middle: Array) -> Alignment | None:
    """The alignment of a solution, or of the middle between it and its mirror image, which lies ``apart`` (3,) from it.

    Where the track lies nearly in the plane of the anchors, the distance from it shows in the second order only: the
    linear covariance is too large there by far, or by chance too small. How far the place may be moved in its worst
    direction, all else following, until the ranges do not fit any more, says how well it is known.
    """
    information = best.jac.T @ best.jac
    if np.linalg.cond(information) > 1e12:
        return None
    covariance = np.linalg.inv(information)
    variances, axes = np.linalg.eigh(covariance[1:4, 1:4])
    linear_std, worst = float(np.sqrt(variances[2])), axes[:, 2]
    x, std, bent = best.x, linear_std, False
    if linear_std > _PLAIN_STD or np.linalg.norm(apart) > _PLAIN_STD:
        ends = [problem.limit(best.x, sign * worst) for sign in (-1.0, 1.0)]
        places = [0.0, float(apart @ worst), *(float((end[1:4] - best.x[1:4]) @ worst) for end in ends)]
        low, high = min(places), max(places)
        x = problem.moved(best.x, worst, 0.5 * (low + high))
        std = max(0.25 * (high - low), 0.5 * float(np.linalg.norm(apart)))
        bent = linear_std > 1.5 * std or float(np.linalg.norm(apart)) > std
    R = yaw_rotation(x[0])
    return Alignment(
        se3(R, x[1:4] - R @ middle),
        float(np.sqrt(covariance[0, 0])),
        float(np.hypot(np.sqrt(variances[1]), std)),
        worst if bent else None,
        std if bent else 0.0,
    )


class _Ranges:
    """Least squares over heading, place of the track's middle, and a bias of each anchor, in units of its deviation.

    centred : (n, 3) the track about its middle; the rest as in `align_ranges`.
    """

    def __init__(self, centred: Array, anchors: Array, distances: Array, std: float, bias_std: float) -> None:
        self.centred, self.anchors, self.distances, self.std, self.bias_std = centred, anchors, distances, std, bias_std
        self.surveyed, self._source = np.unique(anchors, axis=0, return_inverse=True)
        self._biases = len(self.surveyed) if bias_std > 0.0 else 0

    def residual(self, x: Array) -> Array:
        """What is off (n + biases,), in standard deviations."""
        tags = self.centred @ yaw_rotation(x[0]).T + x[1:4]
        off = (np.linalg.norm(tags - self.anchors, axis=1) - self.distances) / self.std
        if not self._biases:
            return np.asarray(off)
        return np.concatenate([off + x[4:][self._source] * (self.bias_std / self.std), x[4:]])

    def jacobian(self, x: Array) -> Array:
        """That of `residual`."""
        turned = self.centred @ yaw_rotation(x[0]).T
        away = turned + x[1:4] - self.anchors
        direction = away / np.maximum(np.linalg.norm(away, axis=1), 1e-6)[:, None] / self.std
        count = len(self.distances)
        J = np.zeros((count + self._biases, 4 + self._biases))
        J[:count, 0] = direction[:, 1] * turned[:, 0] - direction[:, 0] * turned[:, 1]
        J[:count, 1:4] = direction
        if self._biases:
            J[np.arange(count), 4 + self._source] = self.bias_std / self.std
            J[count:, 4:] = np.eye(self._biases)
        return J

    def fits(self, x: Array) -> NDArray[np.bool_]:
        """Which of the ranges (n,) do."""
        return np.asarray(np.abs(self.residual(x)[: len(self.distances)]) < _MISFIT)

    def cost(self, x: Array) -> float:
        """Half the squares of `residual`; what no place explains counts the same for all."""
        return 0.5 * float(np.sum(np.minimum(self.residual(x) ** 2, _MISFIT**2)))

    def cost_of_fits(self, x: Array) -> float:
        """The part of it that is of ranges that fit."""
        return 0.5 * float(np.sum(self.residual(x)[: len(self.distances)][self.fits(x)] ** 2))

    def explained(self, x: Array) -> bool:
        """Whether most ranges fit, and most anchors: one that never does may be blocked, or any of them surveyed wrong.

        Three that fit are no proof against a fourth: what they tell has next to no redundancy.
        """
        fits = self.fits(x)
        good = np.bincount(self._source, fits) > 0.5 * np.bincount(self._source)
        return bool(fits.mean() >= 1.0 - _BAD_PART and (good.all() or good.sum() >= _REDUNDANT))

    def solutions(self) -> list[OptimizeResult]:
        """Where descents from all sides end, and from the mirror images of the best."""
        headings = np.linspace(-np.pi, np.pi, _STARTS, endpoint=False)
        below = self.anchors.mean(axis=0) + [0.0, 0.0, -0.5]
        found = [self._solved(np.array([yaw, *below])) for yaw in headings]
        best = min(found, key=lambda one: self.cost(one.x))
        return found + [self._solved(start) for start in _mirrored(best.x, self.centred, self.surveyed)]

    def moved(self, x: Array, axis: Array, metres: float) -> Array:
        """``x`` moved along a unit vector (3,), all else following."""
        others = np.delete(np.eye(len(x)), [1, 2, 3], axis=1)
        across = np.zeros((len(x), 2))
        across[1:4] = np.linalg.svd(axis[None])[2][1:].T
        free = np.hstack([others, across])
        start = x.copy()
        start[1:4] += metres * axis
        found = least_squares(
            lambda y: self.residual(start + free @ y),
            np.zeros(free.shape[1]),
            lambda y: self.jacobian(start + free @ y) @ free,
            loss="huber",
            f_scale=_HUBER,
            max_nfev=_STEPS,
        )
        return np.asarray(start + free @ found.x)

    def limit(self, x: Array, axis: Array) -> Array:
        """How far ``x`` may be moved along a unit vector (3,) until the ranges say by two sigmas that it is too far."""
        cost = self.cost(x)
        worse = _TOO_FAR * max(1.0, 2.0 * self.cost_of_fits(x) / max(1, int(self.fits(x).sum())))
        metres = _STRIDE_M
        while metres < _FARTHEST_M and self.cost(self.moved(x, axis, metres)) < cost + worse:
            metres *= 1.5
        return self.moved(x, axis, metres)

    def _solved(self, start: Array) -> OptimizeResult:
        """Where a descent ends, and then, without the ranges that do not fit there, others: they drew it aside."""
        found = self._descent(np.append(start, np.zeros(self._biases)), np.ones(len(self.distances), np.bool_))
        used = self.fits(found.x)
        for _ in range(_FITS):
            if used.all() or used.mean() < _SOME_PART:
                break
            found, before = self._descent(found.x, used), used
            used = self.fits(found.x)
            if np.array_equal(used, before):
                break
        return found

    def _descent(self, start: Array, used: NDArray[np.bool_]) -> OptimizeResult:
        """By some of the ranges (n,), and the biases' own."""
        rows = np.append(used, np.ones(self._biases, np.bool_))
        x_scale = [0.1, *np.ones(3 + self._biases)]
        return least_squares(
            lambda x: self.residual(x)[rows],
            start,
            lambda x: self.jacobian(x)[rows],
            loss="huber",
            f_scale=_HUBER,
            x_scale=x_scale,
            max_nfev=_STEPS,
        )


def _in_sight(found: list[OptimizeResult], problem: _Ranges, middle: Array, hidden: Hidden) -> list[OptimizeResult]:
    """The solutions that see the anchors whose ranges fit them."""
    shares = []
    for one in found:
        fits = problem.fits(one.x)
        at = (problem.anchors[fits] - one.x[1:4]) @ yaw_rotation(one.x[0])
        shares.append(float(hidden(problem.centred[fits] + middle, at + middle).mean()) if fits.any() else 1.0)
    most = min(_HIDDEN, min(shares) + _CLEARER)
    return [one for one, share in zip(found, shares, strict=True) if share <= most]


def _mirrored(x: Array, centred: Array, surveyed: Array) -> list[Array]:
    """Where the track's mirror images lie, as heading and place (4,): behind the plane nearest to the anchors, behind
    the plane across it through their longest axis, and behind both."""
    origin = surveyed.mean(axis=0)
    axes = np.linalg.svd(surveyed - origin)[2]
    track = centred @ yaw_rotation(x[0]).T
    images = []
    for across in (axes[2:], axes[1:2], axes[1:]):
        mirror = np.eye(3) - 2.0 * across.T @ across
        yaw = x[0] + _turn_between(track, track @ mirror)
        images.append(np.concatenate([[yaw], origin + mirror @ (x[1:4] - origin)]))
    return images


def _turn_between(a: Array, b: Array) -> float:
    """Turn about the vertical that takes points a (n, 3) onto b (n, 3) best."""
    return float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a[:, :2] * b[:, :2])))
