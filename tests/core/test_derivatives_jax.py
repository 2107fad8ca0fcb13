"""Derivatives of IDW against another implementation, which JAX differentiates (``benchmarks/dense_jax.py``)."""

from pathlib import Path

import numpy as np
import pytest
from cases import body_specs, problem_of, turning
from grids import frame

from meshdeform_core.boundary import Kind
from meshdeform_core.methods import Options, make_method

jax = pytest.importorskip("jax")


@pytest.mark.parametrize("size", [0.0, 0.1])
def test_jax_finds_the_same_derivatives(size, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    twin = pytest.importorskip("dense_jax")
    where = problem_of(frame(), body_specs(turning(10), Kind.FREE))
    moving = (where.boundary.kind[where.source_numbers] == Kind.MOVING)[:, None]
    at = size * moving * np.sin(1.3 * where.source_points[:, [1, 0, 2]] + np.arange(3))
    method = make_method(Options("idw", idw=twin.OPTIONS)).prepare(where)
    flat = method.mover.bound.flat
    theirs, ours = twin.dense(where, where.grid.points[flat]), method.linearised(at)
    np.testing.assert_allclose(method.apply(at)[flat], theirs(at), rtol=0, atol=1e-12)
    random, weight = np.random.default_rng(1), np.zeros_like(where.grid.points)
    change, weight[flat] = random.standard_normal(at.shape) * moving, random.standard_normal((len(flat), 3))
    expected = np.asarray(jax.jvp(theirs, (at,), (change,))[1])
    np.testing.assert_allclose(ours.push(change)[flat], expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    expected = np.asarray(jax.vjp(theirs, at)[1](weight[flat])[0]) * moving
    np.testing.assert_allclose(ours.pull(weight.copy()) * moving, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
