"""Grid deformation in JAX programs, with derivatives in both modes; needs the extra ``jax``.

    from meshdeform.jax import deform_function

    deform = deform_function(mesh)  # displacement (n_moving, 3) -> list of blocks
    gradient = jax.grad(lambda d: cost(deform(d)))(displacement)

The grid is deformed outside of JAX, on the host, in double precision: switch on ``jax_enable_x64``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from meshdeform_core.errors import GridError, MethodError
from meshdeform_core.grid import FloatArray
from meshdeform_core.repair.options import Mode

from .mesh import Linearisation, Mesh, Repeated
from .step import unusable

__all__ = ["deform_function"]

Blocks = list[Any]


def deform_function(
    mesh: Mesh, mode: Literal["reverse", "forward"] = "reverse", *, steps: int = 1, repair: Mode = "off"
) -> Callable[[Any], Blocks]:
    """The deformation as a function of JAX: displacements (n_moving, 3) to arrays like ``mesh.grid.blocks``.

    It works inside ``jax.jit`` and, one displacement after another, inside ``jax.vmap``; for a grid given in the plane
    displacements may be (n_moving, 2). A value and its gradient take one deformation.

    Parameters
    ----------
    mode : ``"reverse"`` for ``jax.grad``, ``vjp``, ``jacrev`` (a ``custom_vjp``); ``"forward"`` for ``jax.jvp``,
        ``jacfwd`` (a ``custom_jvp``)
    steps, repair : as of :meth:`Mesh.deform`, by default one step without repair, which has an exact derivative

    Raises
    ------
    jax.errors.JaxRuntimeError
        When a deformed grid is invalid, inside compiled programs and outside of them; it quotes the ``GridError``.
    MethodError
        For single precision, or a displacement of another shape.

    Warns
    -----
    UserWarning
        Where the derivative is not that of the grid, see ``Linearisation.reason``.
    """
    if mode not in ("reverse", "forward"):
        raise MethodError(f"mode = {mode!r}; expected 'reverse' or 'forward'")
    repeated = Repeated(mesh, steps, repair)
    blocks = [jax.ShapeDtypeStruct(block.shape, np.float64) for block in mesh.grid.blocks]

    def called(displacement: Any) -> Blocks:
        given = jnp.asarray(displacement)
        if given.dtype != jnp.float64:
            raise MethodError(
                f"displacement is {given.dtype}; expected float64: jax.config.update('jax_enable_x64', True)"
            )
        expected = [mesh.points.shape, *([(len(mesh.points), 2)] if mesh.plane else [])]
        if given.shape not in expected:
            raise MethodError(f"displacement is {given.shape}; expected {expected[-1]}, like mesh.points")
        return _outside(deformed, blocks, given)

    def deformed(displacement: Any) -> list[FloatArray]:
        step = repeated.step(np.asarray(displacement))
        if not step.valid:
            raise GridError(unusable(step))
        return [np.array(block) for block in step.grid.blocks]

    def linearised(displacement: Any) -> Linearisation:
        return repeated.derivative(np.asarray(displacement), partial(warnings.warn, stacklevel=2))

    if mode == "forward":
        onward = jax.custom_jvp(called)

        def pushed(displacement: Any, change: Any) -> list[FloatArray]:
            return linearised(displacement).jvp(np.asarray(change))

        @onward.defjvp
        def push(at: tuple[Any], change: tuple[Any]) -> tuple[Blocks, Blocks]:
            return called(*at), _outside(pushed, blocks, *at, *change)

        return onward
    backward = jax.custom_vjp(called)

    def pulled(displacement: Any, gradient: list[Any]) -> FloatArray:
        found = linearised(displacement).vjp([np.asarray(block) for block in gradient])
        return found[:, : np.shape(displacement)[1]]

    def end(displacement: Any, gradient: Blocks) -> tuple[Any]:
        like = jax.ShapeDtypeStruct(displacement.shape, np.float64)
        return (_outside(pulled, like, displacement, gradient),)

    backward.defvjp(lambda displacement: (called(displacement), displacement), end)
    return backward


def _outside(function: Callable[..., Any], shape: Any, *arguments: Any) -> Any:
    return jax.pure_callback(function, shape, *arguments, vmap_method="sequential")
