"""The multistep formulas of generalized-alpha in varying steps, on paper.

Symbols are those of `integrators.methods.generalized_alpha_step`. The coefficients depend on
the steps and weights (the paper's eqs 21-27), and A is eliminated as follows. A difference u_n of
known values is a combination of A over two times for v, three for q. The recurrence (1 - alpha_m)
A_n+1 + alpha_m A_n = F_n, with F_n = (1 - alpha_f) a_n+1 + alpha_f a_n, reduces it to known F and
one A with a rest r_n::

    u_n   = ... F_n + ... F_n-1 + r_n   A_n-1
    u_n-1 = ... F_n-1 + ... F_n-2 + r_n-1 A_n-2

and (1 - alpha_m) r_n-1 times the first plus alpha_m r_n times the second is free of A. Where the
rests are zero (rho_inf = 1) all coefficients are: u_n alone is free of A.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Formula(NamedTuple):
    """A multistep formula of one step: values @ u = rates @ (derivatives of u).

    Both have one coefficient for each of the last times, the latest first.
    """

    values: np.ndarray
    rates: np.ndarray


def velocity_formula(m: float, f: float, h: Sequence[float], weight: Sequence[float]) -> Formula:
    """Return the formula for v (or x) over three times in varying steps.

    Parameters
    ----------
    m, f
        alpha_m and alpha_f; delta_m and delta_f for x.
    h, weight
        The last two steps in s and their weights gamma (or theta), the latest first.
    """
    differences = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    of_aux = [np.array([w, 1 - w]) * step for w, step in zip(weight, h, strict=True)]
    return _eliminated(m, f, differences, of_aux)


def position_formula(
    m: float, f: float, beta: float, h: Sequence[float], gamma: Sequence[float]
) -> Formula:
    """Return the formula for q over four times in varying steps, with q'' as derivative.

    Parameters
    ----------
    m, f, beta
        alpha_m, alpha_f and beta.
    h, gamma
        The last three steps in s and their weights gamma, the latest first.
    """
    rows, of_aux = [], []
    for n in range(2):
        new, old, weight = h[n], h[n + 1], gamma[n + 1]
        rows.append(np.zeros(4))
        rows[n][n : n + 3] = 1 / new, -1 / new - 1 / old, 1 / old
        # (q+ - q)/h - (q - q-)/h-, where v - v- = h- ((1 - gamma-) A- + gamma- A)
        middle = new * (0.5 - beta) + old * (weight - beta)
        of_aux.append(np.array([new * beta, middle, old * (0.5 + beta - weight)]))
    return _eliminated(m, f, np.array(rows), of_aux)


def _eliminated(m: float, f: float, values: np.ndarray, of_aux: Sequence[np.ndarray]) -> Formula:
    """Combine two differences u, given by A at the last times, so that A drops out."""
    times = values.shape[1]
    rates, rests = np.zeros((2, times)), np.zeros(2)
    for n, aux in enumerate(of_aux):
        rest = aux.copy()
        for k in range(len(aux) - 1):  # by the recurrence, from the latest A to the last but one
            part = rest[k] / (1 - m)
            rates[n, n + k : n + k + 2] += part * np.array([1 - f, f])
            rest[k + 1] -= part * m
        rests[n] = rest[-1]
    # rests[0] A and rests[1] A- remain, and (1 - m) A + m A- = F of the oldest step.
    first, second = (1 - m) * rests[1], m * rests[0]
    rates = first * rates[0] + second * rates[1]
    rates[-2:] += rests[0] * rests[1] * np.array([1 - f, f])
    return Formula(first * values[0] + second * values[1], rates)
