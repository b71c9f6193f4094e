"""The closed form of eigenvalues against LAPACK."""

import numpy as np
import pytest

from localize._numba_eigen import eigen3


@pytest.mark.parametrize(
    "spectrum",
    [
        (1e-5, 0.01, 0.02), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 1.0), (-3.0, 2.0, 2.0000001),
        (1e-9, 1.0, 1.0), (1.0, 1.0 + 1e-13, 1.0 + 2e-13), (1e-12, 1e-12, 1e-12), (0.0, 0.0, 0.0), (1e4, 2e4, 5e8),
    ],
)  # fmt: skip
def test_eigenvectors_make_the_matrix_again_whatever_its_spectrum(spectrum):
    rng = np.random.default_rng(3)
    values, vectors = np.empty(3), np.empty((3, 3))
    for turned in range(100):
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
        S = Q @ np.diag(spectrum) @ Q.T
        S = 0.5 * (S + S.T)
        eigen3(S, values, vectors)
        exact = 1e-12 * max(np.abs(spectrum))
        np.testing.assert_allclose(values, np.linalg.eigvalsh(S), rtol=0.0, atol=exact)
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(3), rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(vectors.T @ np.diag(values) @ vectors, S, rtol=0.0, atol=exact)
