"""Sparse weighted least squares: residuals row by row, one Gauss-Newton step, and samples of the errors that are left.

Solving the normal equations for residuals drawn from their own distribution gives samples of the unknowns' errors
(Papandreou and Yuille, "Gaussian sampling by local perturbations", NIPS 2010); one factorisation serves all of them.
"""

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

SAMPLES = 32
DAMPING = 1e-6


def factorise(normal: csc_array) -> SuperLU:
    """Factors of a symmetric positive definite matrix, whose pattern is kept sparse and which needs no pivots."""
    return splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class Equations:
    """Weighted residuals and their derivatives."""

    def __init__(self) -> None:
        self._rows, self._columns, self._values = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        self._residual = list[np.ndarray]()
        self._count = 0

    def add(self, columns: np.ndarray, values: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> None:
        """Add residuals (n,) with derivatives (n, k), each times its weight (n,), one over its standard deviation."""
        count, width = columns.shape
        self._rows.append(np.repeat(self._count + np.arange(count), width))
        self._columns.append(columns.ravel())
        self._values.append((np.broadcast_to(values, columns.shape) * weight[:, None]).ravel())
        self._residual.append(residual * weight)
        self._count += count

    def solve(self, held: np.ndarray, excess: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton step (n,) and samples of the errors (n, SAMPLES).

        Args:
            held: Derivative of a sum that the step must make zero (n,); all zero: there is none.
            excess: What this sum is now.
            rng: Draws the samples.
        """
        unknowns = len(held)
        entries = np.concatenate(self._values), (np.concatenate(self._rows), np.concatenate(self._columns))
        jacobian = csc_array(entries, shape=(self._count, unknowns))
        normal = (jacobian.T @ jacobian).tocsc() + DAMPING * eye_array(unknowns, format="csc")
        solver = factorise(normal.tocsc())
        drawn = rng.standard_normal((self._count, SAMPLES))
        step, samples = -solver.solve(jacobian.T @ np.concatenate(self._residual)), solver.solve(jacobian.T @ drawn)
        if not held.any():
            return step, samples
        along = solver.solve(held)
        along /= held @ along
        return step - along * (held @ step + excess), samples - along[:, None] * (held @ samples)
