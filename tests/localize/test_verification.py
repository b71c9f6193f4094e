"""The ICP check on clouds whose right answer is known."""

import numpy as np
import pytest

from localize.settings import VerificationSettings
from localize.verification import Verifier, start_of
from semmap.geometry import inverse, se3, se3_exp, se3_log, transform, yaw_rotation
from semmap.intersections import Intersection, WallContour

P_MAP = np.array([5_000.0, -3_000.0, 40.0])
_NONE = np.zeros(0, np.float32)


def roadway(rng, length, *, width=4.0, height=3.0, n=6000):
    """Points on floor, roof and walls of a straight roadway along x, 3 cm rough."""
    x = rng.uniform(0.0, length, n)
    turn = rng.integers(0, 4, n)
    across = np.where(turn < 2, rng.uniform(-width / 2, width / 2, n), np.where(turn == 2, -width / 2, width / 2))
    up = np.where(turn == 0, 0.0, np.where(turn == 1, height, rng.uniform(0.0, height, n)))
    return np.stack([x, across, up], axis=1) + 0.03 * rng.normal(size=(n, 3))


def crossing(rng, bearings, length=14.0):
    """Roadways that leave the origin at some bearings [rad]; points inside of another roadway are left out."""
    parts = [roadway(rng, length) @ yaw_rotation(bearing).T for bearing in bearings]
    points = np.concatenate(parts)
    keep = np.ones(len(points), bool)
    for bearing in bearings:
        local = points @ yaw_rotation(bearing)
        inside = (local[:, 0] > 0.0) & (np.abs(local[:, 1]) < 1.8) & (local[:, 2] > 0.2) & (local[:, 2] < 2.8)
        keep &= ~inside
    return points[keep]


def intersection(cloud):
    contour = WallContour(_NONE, _NONE.astype(bool), _NONE[None], _NONE[None].astype(bool))
    return Intersection(3, P_MAP, "T", np.zeros(3), np.zeros(3), 1.0, contour, cloud.astype(np.float32))


T_BEARINGS = np.radians([0.0, 95.0, 185.0])


def check(verifier, seen, p_local, target, yaw, **more):
    """Both looks, as the matcher takes them."""
    points = verifier.around(np.asarray(seen, np.float32), p_local)
    T, _ = verifier.first_look(points, target, start_of(p_local, yaw))
    return verifier.verify(points, target, T, **more)


@pytest.mark.parametrize("seed", range(4))
def test_finds_the_pose_from_a_poor_start(seed):
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-np.pi, np.pi)
    T_map_local = se3(yaw_rotation(yaw), P_MAP + [3.0, -2.0, 1.3])
    seen = transform(inverse(T_map_local), crossing(np.random.default_rng(seed + 50), T_BEARINGS) + P_MAP)
    p_local = transform(inverse(T_map_local), P_MAP[None])[0] + [0.4, -0.3, 0.1]
    target = intersection(crossing(rng, T_BEARINGS))
    verification = check(Verifier(VerificationSettings()), seen, p_local, target, yaw + 0.08)
    error = se3_log(inverse(T_map_local) @ verification.T_map_local)
    assert verification.fit > 0.97 and verification.icp_distance < 0.08
    assert np.abs(error[:3]).max() < 0.003 and np.abs(error[3:]).max() < 0.03
    assert error @ np.linalg.solve(verification.covariance, error) < 16.8  # 99 % of chi-square with 6


def test_another_intersection_does_not_fit():
    rng = np.random.default_rng(0)
    seen = crossing(rng, np.radians([0.0, 60.0, 120.0, 240.0])).astype(np.float32)
    target = intersection(crossing(rng, T_BEARINGS))
    verifier = Verifier(VerificationSettings())
    fits = [check(verifier, seen, np.zeros(3), target, yaw).fit for yaw in np.arange(0.0, 2 * np.pi, 0.5)]
    assert max(fits) < VerificationSettings().min_fit


def test_a_straight_roadway_leaves_the_way_along_it_open():
    rng = np.random.default_rng(0)
    straight = np.radians([0.0, 180.0])
    turn = np.radians(30.0)
    covariance = {}
    for name, bearings in (("straight", straight), ("crossing", T_BEARINGS)):
        cloud = crossing(rng, bearings + turn)
        seen = crossing(rng, bearings + turn).astype(np.float32)
        verification = check(Verifier(VerificationSettings()), seen, np.zeros(3), intersection(cloud), 0.0)
        covariance[name] = verification.covariance
    along = np.array([np.cos(turn), np.sin(turn), 0.0])
    values, vectors = np.linalg.eigh(covariance["straight"][3:, 3:])
    assert abs(vectors[:, 2] @ along) > 0.98
    assert values[2] > 20.0 * values[1]
    assert values[2] > 5.0 * np.linalg.eigvalsh(covariance["crossing"][3:, 3:])[2]


def test_a_partial_view_is_less_certain():
    rng = np.random.default_rng(0)
    cloud = crossing(rng, T_BEARINGS)
    verifier, seen = Verifier(VerificationSettings()), crossing(rng, T_BEARINGS).astype(np.float32)
    whole = check(verifier, seen, np.zeros(3), intersection(cloud), 0.0, completeness=1.0)
    part = check(verifier, seen, np.zeros(3), intersection(cloud), 0.0, completeness=0.5)
    np.testing.assert_allclose(part.covariance, 2.0 * whole.covariance, rtol=0.05)


def test_nothing_to_compare_fits_nothing():
    target = intersection(crossing(np.random.default_rng(0), T_BEARINGS))
    verification = check(Verifier(VerificationSettings()), np.zeros((0, 3)), np.zeros(3), target, 0.0)
    assert verification.fit == 0.0 and verification.points == 0 and np.isinf(verification.icp_distance)


def test_perturbation_of_the_covariance_is_on_the_right():
    """The covariance is in the stack's own axes: turning the stack turns it."""
    rng = np.random.default_rng(0)
    cloud = crossing(rng, np.radians([0.0, 180.0]))
    seen = crossing(rng, np.radians([0.0, 180.0]))
    yaw = 0.7
    turned = transform(inverse(se3_exp([0, 0, yaw, 0, 0, 0])), seen).astype(np.float32)
    covariance = check(Verifier(VerificationSettings()), turned, np.zeros(3), intersection(cloud), yaw).covariance
    _, vectors = np.linalg.eigh(covariance[3:, 3:])
    assert abs(vectors[:, 2] @ [np.cos(yaw), -np.sin(yaw), 0.0]) > 0.98


def test_rock_that_is_only_alike_fits_but_is_less_like():
    """Two crossings of one plan, rough by 6 cm each in its own way: ICP passes both, likeness tells them apart."""
    rng = np.random.default_rng(0)
    plan = crossing(rng, T_BEARINGS, length=12.0)

    def rough(points, seed):
        phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, size=3)
        return points + 0.1 * np.sin(1.5 * points.sum(axis=1, keepdims=True) + 2.0 * points + phase)

    def compared(seed):
        return check(Verifier(VerificationSettings()), seen, np.zeros(3), intersection(rough(plan, seed)), 0.0)

    seen = rough(plan, 1) + 0.01 * rng.normal(size=plan.shape)
    same, other = compared(1), compared(2)
    assert same.fit > 0.95 and other.fit > 0.8
    assert same.likeness > other.likeness + 0.2


@pytest.mark.parametrize("bent_m", [0.0, 0.2])
def test_a_bent_stack_does_not_pull_the_newest_keyframe_along(bent_m):
    """Of three keyframes' points the older two lie ahead of where they were seen."""
    target = intersection(crossing(np.random.default_rng(0), T_BEARINGS))
    rng = np.random.default_rng(1)
    clouds = [crossing(rng, T_BEARINGS) + [ahead, 0.0, 0.0] for ahead in (bent_m, bent_m, 0.0)]
    verifier, floor = Verifier(VerificationSettings()), np.diag(np.repeat([0.001, 0.005], 3) ** 2)
    stacks = check(verifier, np.concatenate(clouds), np.zeros(3), target, 0.0)
    own = verifier.around(np.asarray(clouds[-1], np.float32), np.zeros(3))
    unbent = verifier.unbent(stacks, own, target, floor)
    assert (unbent is stacks) == (bent_m == 0.0)
    error = se3_log(inverse(se3(np.eye(3), P_MAP)) @ unbent.T_map_local)
    assert np.abs(error[3:]).max() < 0.03
    assert error @ np.linalg.solve(unbent.covariance + floor, error) < 16.8
