"""Hypotheses: one sure intersection proves, look-alikes do not, and the next intersection decides between two."""

import numpy as np
import pytest

from localize.hypotheses import Hypotheses, carried
from localize.matcher import Expected, Place, Sight
from localize.recognition import Recognition
from localize.settings import ProofSettings
from semmap.geometry import adjoint, inverse, se3, se3_exp, se3_log, yaw_rotation

PIN = np.diag(np.repeat([0.002, 0.01], 3) ** 2)
LINK = np.diag(np.repeat([0.001, 0.02], 3) ** 2)
STEP = se3_exp([0.0, 0.0, 0.02, 1.0, 0.0, 0.0])
HERE = se3(yaw_rotation(0.3), [10.0, 20.0, 1.0])
THERE = se3(yaw_rotation(-2.0), [90.0, -40.0, 1.0])


def place(T_map_imu, intersection, likeness, *, keyframe=0, fits=True):
    T_map_intersection = se3(np.eye(3), T_map_imu[:3, 3])
    return Place(keyframe, intersection, T_map_imu, PIN, T_map_intersection, 0.97, likeness, 0.03, fits)


def sight(number, step, *places):
    """What keyframe ``step`` saw: keyframes are a metre apart in odom."""
    return Sight(number, step, np.array([float(step), 0.0, 0.0]), places, {"stamp_ns": step}, "")


def moved(T, steps):
    for _ in range(steps):
        T = T @ STEP
    return T


def told(hypotheses, sights):
    """Hand sights over in order, the odometry in between; what was proven, and when."""
    step = 0
    for one in sights:
        for _ in range(one.keyframe - step):
            hypotheses.carry(STEP, LINK)
        step = one.keyframe
        proven = hypotheses.take(one)
        if proven is not None:
            return proven, step
    return None, step


def test_one_sure_intersection_is_proven_by_a_second_view():
    views = [sight(0, k, place(moved(HERE, k), 7, 0.95)) for k in (0, 1, 3)]
    proven, step = told(Hypotheses(ProofSettings()), views)
    assert proven is not None and step == 3 and {pin.intersection for pin in proven.pins} == {7}
    np.testing.assert_allclose(proven.at.T_map_imu, moved(HERE, 3), atol=1e-9)


def test_one_look_alike_is_never_proven_however_often_it_is_seen():
    views = [sight(0, k, place(moved(HERE, k), 7, 0.65)) for k in range(12)]
    assert told(Hypotheses(ProofSettings()), views)[0] is None


def test_two_places_alike_stay_open_until_the_next_intersection_tells():
    both = [sight(0, k, place(moved(HERE, k), 7, 0.95), place(moved(THERE, k), 8, 0.95)) for k in range(6)]
    hypotheses = Hypotheses(ProofSettings())
    assert told(hypotheses, both)[0] is None and len(hypotheses.expected) == 2
    for _ in range(20):
        hypotheses.carry(STEP, LINK)
    proven = hypotheses.take(sight(1, 25, place(moved(THERE, 25), 9, 0.9)))
    assert proven is not None and {pin.intersection for pin in proven.pins} == {8, 9}


def test_several_intersections_of_middling_likeness_prove_together():
    """Noisy maps: each counts by its likeness, and all must agree with the odometry between them."""
    views = [sight(n, 10 * n, place(moved(HERE, 10 * n), n, 0.7)) for n in range(3)]
    proven, step = told(Hypotheses(ProofSettings()), views)
    assert proven is not None and step == 20
    shifted = [
        sight(n, 10 * n, place(moved(HERE, 10 * n) @ se3_exp([0, 0, 0, 3.0 * n, 0, 0]), n, 0.7)) for n in range(6)
    ]
    assert told(Hypotheses(ProofSettings()), shifted)[0] is None


def test_what_is_seen_where_it_cannot_be_counts_against():
    hypotheses = Hypotheses(ProofSettings())
    hypotheses.take(sight(0, 0, place(HERE, 7, 0.84)))
    for _ in range(10):
        hypotheses.carry(STEP, LINK)
    hypotheses.take(sight(1, 10, place(moved(HERE, 10), 8, 0.2, fits=False)))
    for _ in range(10):
        hypotheses.carry(STEP, LINK)
    assert hypotheses.take(sight(2, 20, place(moved(HERE, 20), 9, 0.84))) is None


@pytest.mark.parametrize("seed", range(3))
def test_the_odometry_carries_pose_and_covariance_on(seed):
    """Samples of start and link scatter as the carried covariance says."""
    rng = np.random.default_rng(seed)
    link = np.diag([0.02, 0.03, 0.04, 0.1, 0.2, 0.05]) ** 2
    at = carried(Expected(HERE, PIN), STEP, link)
    start = HERE @ se3_exp(rng.multivariate_normal(np.zeros(6), PIN, size=4000))
    samples = start @ STEP @ se3_exp(rng.multivariate_normal(np.zeros(6), link, size=4000))
    scatter = np.cov(se3_log(inverse(at.T_map_imu) @ samples).T)
    back = adjoint(inverse(STEP))
    np.testing.assert_allclose(at.covariance, back @ PIN @ back.T + link)
    np.testing.assert_allclose(np.diag(scatter), np.diag(at.covariance), rtol=0.1)


def test_a_sure_track_takes_what_agrees_and_doubts_when_it_is_elsewhere():
    recognition, track = Recognition(ProofSettings()), Expected(HERE, PIN)
    agreeing = recognition.judge(sight(0, 0, place(HERE, 7, 0.7)), track)
    assert agreeing.pins and not agreeing.elsewhere
    doubted = recognition.judge(sight(1, 1, place(THERE, 8, 0.95)), track)
    assert not doubted.pins and doubted.doubt
    recognition.hypotheses.carry(moved(np.eye(4), 3), LINK)
    refuted = recognition.judge(sight(1, 4, place(moved(THERE, 3), 8, 0.95)), Expected(moved(HERE, 3), PIN))
    assert refuted.elsewhere and {pin.intersection for pin in refuted.pins} == {8}


def test_an_unsure_track_is_no_proof_of_what_happens_to_agree_with_it():
    """Along a smooth drift the place is open by tens of metres: a look-alike in there must not pin it."""
    wide = Expected(HERE, np.diag([1e-4, 1e-4, 1e-4, 400.0, 0.01, 0.01]))
    recognition = Recognition(ProofSettings())
    alike = place(HERE @ se3_exp([0, 0, 0, 15.0, 0, 0]), 7, 0.65)
    assert not any(recognition.judge(sight(0, k, alike), wide).pins for k in range(5))


def test_two_intersections_missing_where_the_map_has_them_raise_a_doubt():
    recognition, track = Recognition(ProofSettings()), Expected(HERE, PIN)
    first = recognition.judge(sight(0, 0, place(HERE, 7, 0.2, fits=False)), track)
    second = recognition.judge(sight(1, 9, place(HERE, 8, 0.2, fits=False)), track)
    assert not first.doubt and second.doubt
