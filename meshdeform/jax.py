"""Grid deformation in JAX programs, with derivatives in both modes; needs the extra ``jax``.

    from meshdeform.jax import deform_function

    deform = deform_function(mesh)  # displacement (n_moving, 3) -> list of blocks
    gradient = jax.grad(lambda d: cost(deform(d)))(displacement)

The grid is deformed outside of JAX, on the host, in double precision: switch on ``jax_enable_x64``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from meshdeform_core.errors import GridError, MethodError
from meshdeform_core.grid import FloatArray
from meshdeform_core.repair.options import Mode

from .prepared.linearisation import Linearisation
from .prepared.mesh import Mesh

__all__ = ["deform_function"]

Blocks = list[Any]


def deform_function(
    mesh: Mesh, mode: Literal["reverse", "forward"] = "reverse", *, steps: int = 1, repair: Mode = "off"
) -> Callable[[Any], Blocks]:
    """The deformation as a function of JAX: displacements (n_moving, 3) to arrays like ``mesh.grid.blocks``.

    It works inside ``jax.jit`` and, one displacement after another, inside ``jax.vmap``.

    Parameters
    ----------
    mode : ``"reverse"`` for ``jax.grad``, ``vjp``, ``jacrev`` (a ``custom_vjp``); ``"forward"`` for ``jax.jvp``,
        ``jacfwd`` (a ``custom_jvp``)
    steps, repair : as of :meth:`Mesh.deform`, by default one step without repair, which has an exact derivative

    Raises
    ------
    GridError
        When a deformed grid is invalid (inside compiled programs JAX wraps it in an error of its own).
    MethodError
        For single precision.

    Warns
    -----
    UserWarning
        Where the derivative is not that of the grid, see ``Linearisation.reason``.
    """
    if mode not in ("reverse", "forward"):
        raise MethodError(f"mode = {mode!r}; expected 'reverse' or 'forward'")
    host = _Host(mesh, steps, repair)
    return host.reverse() if mode == "reverse" else host.forward()


class _Host:
    """What is called outside of JAX, with the derivative at the last displacement."""

    def __init__(self, mesh: Mesh, steps: int, repair: Mode):
        self._mesh, self._steps, self._repair = mesh, steps, repair
        self._at: FloatArray = np.empty((0, 3))
        self._derivative: Linearisation | None = None
        self._points = jax.ShapeDtypeStruct(mesh.points.shape, np.float64)
        self._blocks = [jax.ShapeDtypeStruct(block.shape, np.float64) for block in mesh.grid.blocks]

    def reverse(self) -> Callable[[Any], Blocks]:
        """The function with its transposed derivative."""
        deform = jax.custom_vjp(self._called)

        def begin(displacement: Any) -> tuple[Blocks, Any]:
            return self._called(displacement), displacement

        def end(displacement: Any, gradient: Blocks) -> tuple[Any]:
            return (_outside(self._pull, self._points, displacement, gradient),)

        deform.defvjp(begin, end)
        return deform

    def forward(self) -> Callable[[Any], Blocks]:
        """The function with its forward derivative."""
        deform = jax.custom_jvp(self._called)

        @deform.defjvp
        def push(at: tuple[Any], change: tuple[Any]) -> tuple[Blocks, Blocks]:
            return self._called(*at), _outside(self._push, self._blocks, *at, *change)

        return deform

    def _called(self, displacement: Any) -> Blocks:
        given = jnp.asarray(displacement)
        if given.dtype != jnp.float64:
            raise MethodError(
                f"displacement is {given.dtype}; expected float64: jax.config.update('jax_enable_x64', True)"
            )
        if given.shape != self._points.shape:
            raise MethodError(f"displacement is {given.shape}; expected {self._points.shape}, like mesh.points")
        return _outside(self._deform, self._blocks, given)

    def _deform(self, displacement: Any) -> list[FloatArray]:
        step = self._mesh.deform(np.asarray(displacement), steps=self._steps, repair=self._repair)
        if not step.valid:
            first = step.invalid_cells[0] if step.invalid_cells else "none is invalid"
            raise GridError(f"the deformed grid cannot be used: {step!r}; first cell: {first}")
        return [np.array(block) for block in step.grid.blocks]

    def _push(self, displacement: Any, change: Any) -> list[FloatArray]:
        return self._linearised(displacement).jvp(np.asarray(change))

    def _pull(self, displacement: Any, gradient: list[Any]) -> FloatArray:
        return self._linearised(displacement).vjp([np.asarray(block) for block in gradient])

    def _linearised(self, displacement: Any) -> Linearisation:
        at = np.asarray(displacement)
        if self._derivative is None or not np.array_equal(at, self._at):
            found = self._mesh.linearise(at, steps=self._steps, repair=self._repair)
            if not found.exact:
                warnings.warn(f"the derivative is not that of the grid: {found.reason}", stacklevel=2)
            self._at, self._derivative = at.copy(), found
        return self._derivative


def _outside(function: Callable[..., Any], shape: Any, *arguments: Any) -> Any:
    return jax.pure_callback(function, shape, *arguments, vmap_method="sequential")
