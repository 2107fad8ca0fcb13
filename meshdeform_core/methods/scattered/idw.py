"""Inverse distance weighting of rigid motions (Sen et al. section 2.3; Luke et al. 2012; Witteveen 2010)."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...errors import MethodError
from ...grid import BoolArray, FloatArray, IntArray
from ...numerics import rotation as rot
from ...numerics.arrays import lengths, places_among, weighted_total
from ...numerics.rigid import AT_REST, NO_TRANSITION, Columns, Frame, finish
from ...numerics.tape import Tape, Tracked, plain
from ...parallel import Nodes
from ..base import Account, Kinks, Linearised, Problem, Progress, Setting, of_stage
from ..limits import (
    FOLDED,
    HALF_TURNS,
    LARGEST,
    LARGEST_ROTATION,
    PLAIN_ROTATION,
    half_turns,
    tied,
    warn_of_alpha,
    warn_of_rotation,
)  # fmt: skip
from ..options import MethodOptions, option
from .idw_sums import ExactSums, SourceValues, apply_fast, interpolation_order, sums_of_groups
from .images import mirror_images, motion_values, transition_of
from .summation import Summation, fast_pays, summation_tolerance

if TYPE_CHECKING:
    from ...numerics.fastsum.weighted import FastSums

# The exponents and the transition were tuned together: they result from large motions of the samples and of third-party
# grids (studies/which_method.py, studies/robustness_table.py) and from random motions of whole boundaries
# (studies/random_flows.py), see docs/methods.md ("IDW") and docs/validity.md; after a change, run all three.
ALPHA_CAP = 0.3
"""Largest alpha that eq. 18 may choose; larger values cross cells if a = 3 and there is no transition."""
FAR, FAR_IN_PLANES = 3.0, 2.5
"""Exponent a of eq. 16: Luke's, and that of ``lie`` in plane grids without a transition.

The weights of a surface decay like r^(2 - a), those of a curve like r^(1 - a): between two surfaces Luke's exponent
spreads the deformation evenly, between two curves it concentrates the deformation half-way.
"""
FAR_OF_ONE_BODY = 4.0
"""Exponent a of eq. 16 for one moving body with a transition; it then matters only along the body."""
WIDTH, WIDTH_IN_PLANES = 0.5, 0.3
"""Fraction of the gap at either end over which the slope of the share changes (``transition``)."""
ROUNDS = 8
"""Rounds of smoothing near sharp edges with ``lie``."""
STEEPER = 1.5
"""With a transition, fast sums are made accurate for displacements larger by this factor, as the share may vary faster
than the weights."""
_LEAST_ALPHA = 1e-3
_ENCLOSED = 1e-6
"""Largest relative gap between the extent of a boundary and that of the grid that it encloses."""
# Powers of distances relative to the grid remain finite up to these exponents.
_FACTOR, _EXPONENT = "(0, 1e4]", "(0, 20]"
_LUKE: Mapping[str, tuple[str, ...]] = {"weights": ("luke",)}
_SHEPARD: Mapping[str, tuple[str, ...]] = {"weights": ("shepard",)}


@dataclass(frozen=True)
class IDW(MethodOptions):
    """Weighted mean of the boundary's rigid motions; cost N_v x N_s, no system to solve.

    Moves the near-wall grid rigidly with the wall and pushes the deformation outwards. Fails where a moving wall meets
    a fixed one under large motion (``quaternion``) and at rotations near 180 degrees; ``none`` cannot rotate cells.

    Attributes
    ----------
    rotation : what is averaged. ``none``: displacements (eq. 14); ``quaternion``: rotations and translations about the
        origin of coordinates (eq. 20); ``division``: the same in ``divisions`` steps (eqs. 26-28); ``blend``: predicted
        positions (Luke et al.); ``lie``: the twist, the limit of ``division`` in closed form, independent of the frame
    weights : ``luke`` (eq. 16) or ``shepard`` (eq. 15)
    alpha : weight of near against far sources in eq. 16, or ``"auto"``: eq. 18, at most 0.3
    eta : factor of eq. 18
    a, b : exponents of eq. 16; a may be ``"auto"``: for ``lie`` 4 with one moving body and a transition, else 2.5 in
        plane grids; 3 otherwise
    transition : the share of the moving sources falls linearly across the gap to the fixed ones, except over this
        fraction of the gap at either end (at most 0.5); 0: the weights determine the share, as in eq. 14; ``"auto"``:
        0.5 for ``lie``, 0.3 in plane grids
    smoothing : how often rotations are averaged with those of neighbours, for nodes within as many edges of a sharp
        edge; ``"auto"``: 8 for ``lie``, 0 otherwise
    length : L_def of eq. 16 (grid length unit), or ``"auto"``: eq. 17
    p_moving, p_fixed : exponents of ``shepard`` for moving and fixed sources
    divisions : m of eq. 26
    remove_mean : subtract the mean displacement (for ``lie``, if the whole boundary moves, the mean rigid motion, or
        the mean affine one if it encloses the grid) first and add it back; ``"auto"``: only for ``lie``
    summation : ``exact`` sums, or ``fast`` ones with clusters of sources, or ``"auto"``: fast from 2000
        sources and 2e8 pairs of nodes
    summation_tolerance : of fast sums: error of a node's displacement relative to its shortest cell edge, 1e-8 to 0.1
    """

    rotation: Literal["none", "quaternion", "division", "blend", "lie"] = option(
        "lie", "independent of the frame, keeps walls best, costs one step"
    )
    weights: Literal["luke", "shepard"] = option("luke", "near and far field in one formula, nodal areas included")
    alpha: float | Literal["auto"] = option(
        0.1,
        "0.3 keeps walls better at large rotations, but skews the cells farther away more",
        range=_FACTOR,
        only_if=_LUKE,
    )
    eta: float = option(5.0, "Luke et al.", range=_FACTOR, only_if={**_LUKE, "alpha": ("auto",)})
    a: float | Literal["auto"] = option(
        "auto", "Luke et al.: 3; for lie by the kind of grid and motion", range=_EXPONENT, only_if=_LUKE
    )
    b: float = option(5.0, "Luke et al.: the near field", range=_EXPONENT, only_if=_LUKE)
    transition: float | Literal["auto"] = option(
        "auto",
        "shears the cells between boundaries evenly; walls move rigidly",
        range="[0, 0.5]",
        only_if={**_LUKE, "rotation": ("lie",)},
    )
    smoothing: int | Literal["auto"] = option(
        "auto", "only for lie, not for the paper's kinds; smooth walls are unaffected", range="[0, inf)"
    )
    length: float | Literal["auto"] = option("auto", "eq. 17: farthest source from the centroid of all nodes")
    p_moving: float = option(
        3.0, "as for fixed nodes; larger values reduce the reach of the moving wall", range=_EXPONENT, only_if=_SHEPARD
    )
    p_fixed: float = option(3.0, "as for moving nodes", range=_EXPONENT, only_if=_SHEPARD)
    divisions: int = option(25, "the paper's; the distance from lie falls as 1/m", only_if={"rotation": ("division",)})
    remove_mean: bool | Literal["auto"] = option("auto", "only for lie, not for the paper's kinds")
    summation: Summation = option("auto", "fast where it pays")
    summation_tolerance: float = summation_tolerance()

    def bind(self, problem: Problem, flat: IntArray) -> PreparedIDW:
        """Bind to the sources, their images at symmetry planes, nodal areas, L_def, and to target nodes ``flat``."""
        return PreparedIDW(self, problem, flat)


class PreparedIDW:
    """IDW bound to the sources and the target nodes ``flat`` of one undeformed grid."""

    def __init__(self, options: IDW, problem: Problem, flat: IntArray):
        self.options, self.problem, self.flat = options, problem, flat
        self.account = Account()
        self.images = mirror_images(problem)
        self.rotations = problem.rotations
        if problem.boundary.mirrors:
            self.rotations = rot.SurfaceRotations(
                self.images.points, self.images.corners, self.images.edges, problem.plane_normal
            )
        farthest = np.linalg.norm(problem.source_points - problem.centroid, axis=1).max()
        # Eq. 17, or as given.
        self.length = float(farthest if options.length == "auto" else options.length)
        # Fraction of the gap at either end of the transition, 0 without a transition.
        moving, width = self.images.with_motion, 0.0
        if "transition" not in options.idle and moving.any() and not moving.all():
            auto_width = WIDTH_IN_PLANES if problem.plane else WIDTH
            width = auto_width if options.transition == "auto" else float(options.transition)
        if options.a != "auto":
            self.far = float(options.a)
        elif width and self.images.bodies == 1:
            self.far = FAR_OF_ONE_BODY
        else:
            self.far = FAR_IN_PLANES if problem.plane and options.rotation == "lie" else FAR
        self._transition = transition_of(self.images, problem, self.far, width) if width else NO_TRANSITION
        auto_rounds = ROUNDS if options.rotation == "lie" else 0
        self._rounds = auto_rounds if options.smoothing == "auto" else int(options.smoothing)
        # Pairs (e, 2) of neighbouring sources, the first of which is close to a sharp edge.
        surface = self.images.corners, self.images.edges, problem.plane_normal
        self._blunt = rot.neighbours(*surface) if self._rounds else np.empty((0, 2), dtype=np.int64)
        if len(self._blunt):
            near = rot.near_sharp_edges(self.images.points, *surface, self._rounds)
            self._blunt = self._blunt[near[self._blunt[:, 0]]]
        self.groups, self.strength = self._grouped()
        auto = options.remove_mean == "auto"
        self.remove_mean = options.rotation == "lie" if auto else bool(options.remove_mean)
        # Beyond the moving boundary, stretches would grow with the distance.
        self._stretches = False
        if moving.all():
            faces = problem.grid.nodes.at(problem.topology.first)
            whole, own = (np.ptp(points, axis=0) for points in (faces, problem.source_points))
            self._stretches = bool((own >= (1.0 - _ENCLOSED) * whole).all())
        self._record(auto)
        n_targets, n_sources = sum(problem.grid.nodes.gather(len(flat))), len(self.images.points)
        fast, self.account.settings["summation"] = fast_pays(options.summation, n_targets, n_sources)
        # Sums over clusters; without them every node is summed with every source.
        self.fast: FastSums | None = None
        if fast:
            self.account.settings |= options.used("summation_tolerance")
            problem.grid.hold_neighbours()
            order = interpolation_order(options.summation_tolerance)
            # Up to half of the remaining memory may hold data between displacements.
            self.fast = sums_of_groups(self, self.groups, order, problem.memory.size // 2)

    def _grouped(self) -> tuple[tuple[IntArray, ...], FloatArray]:
        """Groups of sources (index arrays) with a common weight function, and the strength (n,) of every source."""
        o, moving = self.options, self.images.moving
        everything = (np.arange(len(moving)),)
        if o.weights == "luke":
            # Relative to the largest area, as in fast sums: the transition needs total weights in known units.
            return everything, self.images.area / self.images.area.max()
        if o.p_moving == o.p_fixed or moving.all() or not moving.any():
            return everything, np.ones(len(moving))
        # (L_def / r)^p: with two exponents the result depends on the reference length, so it has to be the grid's.
        strength = np.where(moving, self.length**o.p_moving, self.length**o.p_fixed)
        return (np.flatnonzero(moving), np.flatnonzero(~moving)), strength

    def _record(self, mean_is_auto: bool) -> None:
        o, settings = self.options, self.account.settings
        settings |= o.used("rotation", "weights")
        if o.weights == "luke":
            of = {FAR_OF_ONE_BODY: "one moving body", FAR_IN_PLANES: "lie in a plane grid"}
            a = Setting(self.far, of.get(self.far, "Luke et al.: the far field") if o.a == "auto" else "given")
            settings |= o.used("alpha") | {"a": a} | o.used("b")
            width = self._transition.width
            why_width = "lie" if width else "only for lie between moving and fixed boundaries"
            settings["transition"] = Setting(width, why_width if o.transition == "auto" else "given")
        else:
            settings |= o.used("p_moving", "p_fixed")
        if o.alpha == "auto":
            settings["alpha"] = Setting("auto", "eq. 18 at each displacement")
            settings |= o.used("eta")
        if o.rotation != "none":
            nodes = len(np.unique(self._blunt[:, 0]))
            why = "given" if o.smoothing != "auto" else "lie" if self._rounds else 'auto: only for rotation = "lie"'
            settings["smoothing"] = Setting(self._rounds, f"{why}; {nodes} nodes are close to sharp edges")
        settings["length"] = dataclasses.replace(o.used("length")["length"], value=self.length)
        if o.rotation == "division":
            settings |= o.used("divisions")
        exact = "a translation of the whole boundary is then reproduced exactly"
        reason = exact if self.remove_mean else 'auto: only rotation = "lie" does'
        settings["remove_mean"] = Setting(self.remove_mean, reason if mean_is_auto else "given")
        if len(moving := self.images.moving) > len(self.problem.source_points):
            settings["mirrored_sources"] = Setting(len(moving), "images at symmetry planes take part")

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        plain = self.options.rotation == "none"
        limit = PLAIN_ROTATION if plain else LARGEST_ROTATION
        what = 'rotation = "none" shears the cells beside them' if plain else "the direction of rotation is ambiguous"
        advice = "take more steps (--steps auto)" + (', or rotation = "lie"' if plain else "")
        warnings = warn_of_rotation(self.problem, step, limit, what, advice)
        if self.options.weights == "luke" and self.options.alpha == "auto":
            warnings += warn_of_alpha(float(self._eq_18(self._arms(self.images.displaced(step)))), ALPHA_CAP)
        return warnings

    def fit(self, displacement: FloatArray, progress: Progress | None = None) -> SourceValues:
        """Rigid motions of the sources for one displacement (n_sources, 3)."""
        images = self.images
        d = images.displaced(displacement)
        frame, inside = self._seen_inside(d)
        if self.options.rotation == "none":
            q, w = np.tile([1.0, 0.0, 0.0, 0.0], (len(d), 1)), np.zeros((len(d), 3))
        else:
            q, w = rot.smoothed(*self.rotations.of(inside), self._blunt, self._rounds)
        rest = frame.relative(images.points, d)
        # Frame-independent kinds are computed relative to the centroid, to reduce round-off.
        origin = np.zeros(3) if self.options.rotation in ("quaternion", "division") else self.problem.centroid
        start = images.points - origin
        values = motion_values(self.options.rotation, self.options.divisions, start, rest, q, w)
        del q
        turn = np.linalg.norm(w, axis=1)
        at_rest = np.flatnonzero((turn == 0.0) & ~d.any(axis=1))
        still = values[:, at_rest[0]] if at_rest.size else None
        transition, shift = NO_TRANSITION, np.linalg.norm(rest, axis=1)
        moving = images.with_motion
        # Where sources outside the moving faces have different motions, the weights determine the share.
        if self._transition.width and not ((others := values[:, ~moving]) != others[:, :1]).any():
            values = np.concatenate([values - others[:, :1], moving[None]])
            transition = self._transition._replace(rest=others[:, 0].copy())
            shift, still = STEEPER * shift, np.zeros(len(values))
        return SourceValues(
            values, self._weight_functions(plain(inside)), shift, turn, origin, frame, still, transition
        )

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None = None) -> None:
        """Write the displacement of the targets into their rows of ``out`` (n_nodes, 3)."""
        rows, report = Nodes.of(out).rows, of_stage(progress, "idw")

        def use_sums(_: slice, flat: IntArray, sums: FloatArray) -> None:
            rows[flat] = self.displacement(fit, flat, np.ascontiguousarray(sums.T))

        if self.fast:
            apply_fast(self, self.fast, fit, use_sums, out, report)
        else:
            ExactSums(self, fit.weights).apply(fit.values, use_sums, progress=report)

    def displacement(self, fit: SourceValues, flat: IntArray, sums: Columns) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat`` from the 1 + k columns (n,) of their sums."""
        o, x = self.options, Nodes.of(self.problem.grid.nodes.rows).at(flat)
        steps = o.divisions if o.rotation == "division" else 1
        return fit.frame.absolute(x, finish(o.rotation, sums, x - fit.origin, steps, fit.transition))

    def reduced(self, acting: BoolArray) -> PreparedIDW:
        """The same with only the ``acting`` (n,) images of sources, in order, followed by the first of the others, with
        the area of all of them: they share the same values whatever the others do.

        Faces and their edges connect acting sources only.
        """
        images, rest = self.images, np.flatnonzero(~acting)
        kept = np.concatenate([np.flatnonzero(acting), rest[:1]])
        number = places_among(kept, len(acting))
        area = images.area[kept]
        if rest.size:
            area[-1] = images.area[rest].sum()
        found = copy.copy(self)
        found.images = dataclasses.replace(
            images, points=images.points[kept], area=area, owner=images.owner[kept], reflection=images.reflection[kept],
            moving=images.moving[kept], corners=number[images.corners], edges=number[images.edges],
        )  # fmt: skip
        surface = found.images.points, found.images.corners, found.images.edges
        found.rotations = rot.SurfaceRotations(*surface, self.problem.plane_normal)
        found._blunt = number[self._blunt]
        return found

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative of the displacement of the targets at a displacement (n_sources, 3).

        Rotations, their smoothing and the mean motion are recorded operation by operation.
        """
        from .linear_idw import LinearIDW

        # Within the frame of the mean motion, all sources at rest move alike.
        acting = self.images.with_motion | self.images.displaced(displacement).any(axis=1)
        method, variable, o = self.reduced(acting), Tape().variable(displacement), self.options
        images, fit = method.images, method.fit(variable)  # type: ignore[arg-type]
        alpha, slope, kinks = None, 0.0, Kinks()
        if o.rotation != "none":
            kinks[HALF_TURNS] = half_turns(plain(fit.turn), images.owner)
            kinks[FOLDED] = method.rotations.folded(images.displaced(displacement))
        if o.weights == "luke" and o.alpha == "auto":
            arms = method._arms(method._seen_inside(images.displaced(variable))[1])  # type: ignore[arg-type]
            found: Tracked = method._eq_18(arms)  # type: ignore[assignment]
            if _LEAST_ALPHA < float(plain(found)) < ALPHA_CAP:
                # The derivative of the factor of r^-b.
                alpha, slope = found, o.b * float(plain(found)) ** (o.b - 1.0) * method.length ** (o.b - method.far)
                kinks[LARGEST] = tied(lengths(plain(arms)), images.owner)
        derivative = LinearIDW(self, variable, fit, acting, alpha, slope)
        return Linearised(derivative.push, derivative.pull, +kinks)

    def _seen_inside(self, d: FloatArray) -> tuple[Frame, FloatArray]:
        """The mean motion of the images, which is removed first, rigid or affine for ``lie`` if all of them move, and
        their displacements (n, 3) as seen from there if it turns: half a turn of the whole boundary is no special case
        then."""
        frame = AT_REST
        if self.remove_mean and self.options.rotation == "lie" and self.images.with_motion.all():
            normal = self.problem.plane_normal
            frame = Frame.fitted(self.images.points, d, self.images.area, normal, self._stretches)
        elif self.remove_mean:
            frame = Frame(self._mean(d))
        return frame, d if frame.turn is None else frame.relative(self.images.points, d)

    def _weight_functions(self, d: FloatArray) -> tuple[tuple[float, float, float], ...]:
        """Weight function (a, b, kappa) of each group: r^-a + kappa r^-b.

        Only ratios of weights matter; division by L_def^a keeps the numbers near one.
        """
        o = self.options
        if o.weights == "shepard":
            # With kappa = 0 the second exponent has no effect; 5 selects the fastest loop.
            return tuple((p, 5.0, 0.0) for p in (o.p_moving, o.p_fixed)[: len(self.groups)])
        if o.alpha == "auto":
            full = float(self._eq_18(self._arms(d)))
            alpha = min(max(full, _LEAST_ALPHA), ALPHA_CAP)
            reason = f"eq. 18 gives {full:.3g}" + (f", capped at {ALPHA_CAP} (crossed cells)" if full > alpha else "")
            self.account.settings["alpha"] = Setting(alpha, reason)
        else:
            alpha = float(o.alpha)
        try:
            near = alpha**o.b * self.length ** (o.b - self.far)
        except OverflowError as error:
            raise MethodError(
                f"method.idw: alpha^b L^(b - a) with alpha = {alpha:g}, L = {self.length:g}, a = {self.far:g}, "
                f"b = {o.b:g} is too large a number; expected length near the size of the grid, which is the default"
            ) from error
        return ((self.far, o.b, near),)

    def _arms(self, d: FloatArray) -> FloatArray:
        """Displacements (n, 3) of the images relative to their mean."""
        return d - self._mean(d)

    def _mean(self, d: FloatArray) -> FloatArray:
        """Mean (3,) of displacements (n, 3) of the images, weighted with their areas."""
        return weighted_total(self.images.area / self.images.area.sum(), d)

    def _eq_18(self, arms: FloatArray) -> FloatArray:
        """Alpha by eq. 18, without its limits, for displacements (n, 3) relative to their mean."""
        size: FloatArray = np.linalg.norm(arms, axis=1)
        alpha: FloatArray = self.options.eta / self.length * size.max()
        return alpha
