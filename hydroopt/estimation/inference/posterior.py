"""Intervals that remain valid when constraints are active: samples of the posterior, truncated by the constraints.

Residuals and priors make a Gaussian posterior; bounds, physical consistency, statements about bodies and the user's
constraints truncate it, and a log-det distance makes it non-Gaussian. Its samples are drawn by elliptical slice
sampling (Murray, Adams, MacKay 2010), many chains side by side, about a Gaussian that is like the truncated one:
ellipses about a mean that constraints exclude would hardly ever meet possible places. A barrier gives the first such
Gaussian (`hydroopt.estimation.inference.barrier`), the chains' own mean and spread during the warm-up the next ones
(Nishihara, Murray, Adams 2014); where log-det distances make its tails exponential, ellipses are those of a Student-t,
a Gaussian of random scale (same source). Covariances of the unconstrained problem would be wrong at an active
constraint, and those of the active set alone too small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import convex_program
from hydroopt.estimation.inference.barrier import Interior, Matrices, interior
from hydroopt.estimation.inference.conditions import MARGIN, UPPER, Condition
from hydroopt.estimation.inference.constraints import Named, as_casadi
from hydroopt.estimation.inference.problem import StatedProblem
from hydroopt.estimation.inference.truncated import Marginal, TruncatedGaussian, of_samples
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian_posterior
from hydroopt.spatial.inertia import Array

Mask = NDArray[np.bool_]

CHAINS, WARM_UP, SWEEPS, APART = 128, 30, 5, 4
"""Number of chains; sweeps of a warm-up and after which places are kept; how many sweeps apart these are at least:
chains remember their places for about eight, and what is made of places takes longer than a sweep."""
BLOCK, TRIES = 12, 4
"""Coordinates moved together; proposals of each move."""
HEAVY_BLOCK, FREEDOMS = 8, 4.0
"""Where log-det distances make exponential tails: coordinates moved together, and degrees of freedom of the Student-t
about which they move then. About a Gaussian, chains hardly ever enter or leave such tails: spreads came out 4 % too
small."""
DRIFT, MEMORY, ROUNDS = 0.5, 0.5, 8
"""Chains have settled when, over the later half of all sweeps so far, their mean moves by less than this many of its
standard deviations and their places correlate by less than this, in every coordinate; they are given this many
warm-ups. Slow chains, those of slender bodies with widely uncertain centres of mass, need some of them."""
WIDER = 1.2
"""Width of the Gaussian that stands in, over that of the chains: one that is too narrow never leaves their tails."""
COARSE = 0.03
"""Standard error of a width, as a part of it, from which on it is stated."""
NEARER = 0.8
"""Factor by which a chain's first place moves towards the centre until it is possible."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """What samples say of the parameters, and how they were drawn.

    Attributes:
        samples: (s, p) of the parameters.
        mean: (p,) of them; None where the mean of possible parameters is not itself possible: constraints that are not
            convex.
        truncated: where nothing but a Gaussian is cut off, this Gaussian, with the slack (m, s) of its conditions at
            the samples.
        sampled: what the samples are of, in words.
        converged: whether the chains reached their stationary distribution.
    """

    samples: Array
    mean: Array | None
    truncated: tuple[TruncatedGaussian, Array] | None
    sampled: str
    converged: bool = True

    def marginal(self, rows: Array) -> Marginal:
        """Distributions of linear sums (k, p) of the parameters."""
        if self.truncated is not None:
            return self.truncated[0].marginal(self.samples, self.truncated[1], rows, CHAINS)
        return of_samples(rows @ self.samples.T, CHAINS)

    @cached_property
    def own(self) -> Marginal:
        """Those of the parameters one by one."""
        return self.marginal(np.eye(self.samples.shape[1]))

    def interval(self, rows: Array | None = None) -> tuple[Array, Array]:
        """Standard deviation (k,) and 95 % interval (k, 2) of the parameters, or of linear sums of them (k, p)."""
        found = self.own if rows is None else self.marginal(rows)
        return found.std.copy(), found.interval.copy()

    @property
    def note(self) -> str:
        """How they were drawn, and how exact intervals are."""
        error = float(np.max(self.own.error, initial=0.0))
        return (f"intervals from the {self.sampled} cut off by bounds and constraints: {len(self.samples)} samples by "
                "elliptical slice sampling"
                + f"; standard errors of their widths up to {100 * error:.2g} %" * (error > COARSE)
                + ", which did not converge" * (not self.converged))


def sample(problem: StatedProblem, R: Array, r: Array, psi: Array, *, consistent: bool,
           seed: int) -> Posterior | None:
    """Sample the posterior around the estimate ψ; None (with no samples) where a constraint forbids it.

    Args:
        problem: priors, bounds and constraints.
        R: (p, p) and r (p,): weighted residuals ``‖R·ψ − r‖²``.
        psi: (p,) the constrained estimate, near which the search for possible parameters begins where the nominal ones
            are not.
        consistent: whether bodies must be possible.
        seed: of the random numbers.
    """
    conditions = problem.requirements(consistent=consistent)
    user = _user_constraints(problem)
    gaussian = gaussian_posterior(problem, R, r).conditioned_on(conditions)
    if user is None or gaussian is None:
        return None
    density = _Density(problem, gaussian, user, conditions)
    inside = interior(_possible_points(problem, gaussian, user, density, psi, consistent=consistent),
                      gaussian.root, gaussian.right, density.matrices, density.single)
    if inside is None:
        return None
    rng = np.random.default_rng(seed)
    chains = _Chains.standing_in(density, inside, rng)
    settled, earlier = False, list[Array]()
    for warm_ups in range(1, ROUNDS + 1):
        for _ in range(2):
            chains = chains.refitted()
            earlier.append(chains.places)
            for _ in range(WARM_UP // 2):
                chains.sweep(rng)
        settled = _settled(chains.inside.coordinates(earlier[warm_ups]), chains.state)
        if settled:
            break
    places, slack = [], []
    for _ in range(SWEEPS):  # as far apart as it takes these chains to forget their places
        for _ in range(APART * (warm_ups if settled else 1)):
            chains.sweep(rng)
        places.append(chains.places)
        slack.append(chains.slack.copy())
    z = np.concatenate(places, axis=1)
    samples = density.parameters(z)
    alone = not density.distant.size and user.inequality is None
    return Posterior(
        samples, samples.mean(axis=0) if density.possible(z.mean(axis=1)) else None,
        (TruncatedGaussian(gaussian, density.slope, density.bodies), np.concatenate(slack, axis=1)) if alone else None,
        "Gaussian posterior" if problem.distance == "gaussian" else "posterior with log-det distances", settled)


def _possible_points(problem: StatedProblem, gaussian: GaussianPosterior, user: _UserConstraints,
                     density: _Density, psi: Array, *, consistent: bool) -> Iterator[Array]:
    """Points z (k,) inside: the nominal parameters, a little away from bounds, and one near the estimate ψ, which takes
    longer to find."""
    parameters = problem.parameters
    away = np.minimum(0.1 * parameters.scale, 0.25 * (parameters.upper - parameters.lower))
    nominal = np.clip(parameters.nominal, parameters.lower + away, parameters.upper - away)
    # in the Gaussian's coordinates; what leaves the equalities is dropped
    slope, offset = gaussian.slope / parameters.scale[:, None], gaussian.offset
    stated, start = np.linalg.lstsq(slope, ((np.stack([nominal, psi]) - offset) / parameters.scale).T, rcond=None)[0].T
    if density.possible(stated):
        yield np.asarray(stated)
    for distance in (1e-1, 1e-2, 1e-3):
        inner = convex_program.inner_point(problem, gaussian, start, consistent=consistent, margin=1e-3 * distance)
        if inner is not None and density.possible(inner := user.inwards(inner, gaussian, distance)):
            yield inner
            return


class _Density:
    """The posterior in the whitened coordinates z (k,), relative to their standard normal density; a column each place.

    All linear functions that must not be negative have the slopes `slope` (m, k): the first entries of the `bodies`
    matrices that must be positive definite, the second entries, ..., then single ones.
    """

    def __init__(self, problem: StatedProblem, gaussian: GaussianPosterior, user: _UserConstraints,
                 conditions: Sequence[Condition]) -> None:
        matrices = [c for c in conditions if c.kind == "semidefinite"]
        linear = [c for c in conditions if c.kind == "nonnegative"]
        weights = {body.consistency: body.weight for body in problem.bodies}
        self.weights = np.array([weights.get(c.name, 0.0) for c in matrices])
        self.distant = np.flatnonzero(self.weights)
        self._spread = np.array([body.spread for body in problem.bodies if body.weight])
        self.bodies, p = len(matrices), len(problem.parameters)
        order = np.arange(10 * self.bodies).reshape(-1, 10).T.ravel()
        rows = np.vstack([np.zeros((0, p)), *(c.rows for c in matrices)])[order]
        right = np.concatenate([np.zeros(0), *(c.right + MARGIN / 2 * (UPPER[0] == UPPER[1]) for c in matrices)])[order]
        gradient = np.vstack([rows, *(c.rows for c in linear)])
        self.slope = gradient @ gaussian.slope
        self._start = gradient @ gaussian.offset - np.concatenate([right, *(c.right for c in linear)])
        self._gaussian, self._user = gaussian, user

    def parameters(self, z: Array) -> Array:
        """ψ (c, p) at places z (k, c)."""
        return np.asarray(self._gaussian.offset + (self._gaussian.slope @ z).T)

    def slack(self, z: Array) -> Array:
        """The linear functions (m, c) at places z (k, c)."""
        return np.asarray(self._start[:, None] + self.slope @ z)

    def matrices(self, z: Array) -> Matrices:
        """All matrices at z (k,)."""
        rows = 10 * self.bodies
        return Matrices(self.slack(z[:, None])[:rows].reshape(10, -1).T,
                        self.slope[:rows].reshape(10, self.bodies, len(z)).swapaxes(0, 1), self.weights)

    def single(self, z: Array) -> tuple[Array, Array]:
        """All other inequalities (m,) at z (k,), and their slopes (m, k)."""
        rows = 10 * self.bodies
        value, slope = self._user.slack(z, self._gaussian)
        return np.append(self.slack(z[:, None])[rows:, 0], value), np.vstack([self.slope[rows:], slope])

    def possible(self, z: Array) -> bool:
        """Whether all inequalities hold at z (k,)."""
        return bool(self.logarithm(self.slack(z[:, None]), lambda: z[:, None])[0] > -np.inf)

    def logarithm(self, slack: Array, places: Callable[[], Array]) -> Array:
        """Its logarithm (c,) by the slack (m, c) at places z (k, c), −∞ where an inequality does not hold."""
        good: Mask = np.all(slack[10 * self.bodies :] >= 0, axis=0)
        correction = np.zeros(len(good))
        if self.bodies:
            entries = slack[: 10 * self.bodies].reshape(10, self.bodies, -1)
            pivots = _pivots(entries)
            good &= np.all(pivots > 0, axis=(0, 1))
            if self.distant.size:
                correction[good] = self._log_det(*(part[:, self.distant][..., good] for part in (entries, pivots)))
        if self._user.inequality is not None:
            good[good] = self._user.satisfied(self.parameters(places()[:, good]))
        return np.where(good, correction, -np.inf)

    def _log_det(self, entries: Array, pivots: Array) -> Array:
        """What log-det distances of the matrices W (10, b, c) weigh beyond the Gaussian that stands in for them."""
        diagonal = UPPER[0] == UPPER[1]
        mean = self._spread[:, None]
        square = np.sum((entries[diagonal] - mean) ** 2, axis=0) + 2 * np.sum(entries[~diagonal] ** 2, axis=0)
        distance = np.sum(entries[diagonal], axis=0) - np.sum(np.log(pivots), axis=0)
        return np.asarray(self.weights[self.distant] @ (square / mean / 4 - distance / 2))


class _Chains:
    """Chains that move along random ellipses about a Gaussian that stands in (Murray, Adams, MacKay 2010).

    Their `state` (k, c) is in the coordinates of this Gaussian; with it change their slack (m, c) and log-density (c,)
    relative to that of standard normal states.
    """

    def __init__(self, density: _Density, inside: Interior, state: Array) -> None:
        self.density, self.inside, self.state = density, inside, state
        self._slope, self._ratio = density.slope @ inside.root, inside.ratio
        self.slack = density.slack(self.places)
        self.log_density = density.logarithm(self.slack, lambda: self.places) + self._relative(state)

    @classmethod
    def standing_in(cls, density: _Density, inside: Interior, rng: np.random.Generator) -> _Chains:
        """Chains that begin as the Gaussian that stands in, moved towards its centre where that is not possible."""
        chains = cls(density, inside, rng.standard_normal((inside.root.shape[1], CHAINS)))
        while np.any(outside := chains.log_density == -np.inf):
            chains = cls(density, inside, np.where(outside, NEARER * chains.state, chains.state))
        return chains

    @property
    def places(self) -> Array:
        """The same z (k, c) in whitened coordinates."""
        return self.inside.places(self.state)

    def refitted(self) -> _Chains:
        """The same chains about a Gaussian with their mean, and wider where they are, so that they move far."""
        mean, width = self.state.mean(axis=1), np.maximum(WIDER * self.state.std(axis=1), 1.0)
        return _Chains(self.density, self.inside.moved(mean, width), (self.state - mean[:, None]) / width[:, None])

    def sweep(self, rng: np.random.Generator) -> None:
        """Move every coordinate of every chain once.

        Each block of coordinates moves along a random ellipse, whose angles shrink until the density is high enough. A
        chain that found no place after `TRIES` stays: every number of rejected places is as likely on the way back, so
        that stopping early keeps the distribution, and the slowest chain does not hold up the others.
        """
        (k, chains), heavy = self.state.shape, bool(self.density.distant.size)
        size = HEAVY_BLOCK if heavy else BLOCK
        order, starts = rng.permutation(k), range(0, k, size)
        # how the bracket shrinks does not depend on the inequalities: all places to try are known beforehand
        chance = rng.random((TRIES, len(starts), chains))
        angles = np.empty_like(chance)
        angles[0] = 2 * np.pi * chance[0]
        low, high = angles[0] - 2 * np.pi, angles[0]
        for n in range(1, TRIES):
            angles[n] = low + (high - low) * chance[n]
            low, high = np.where(angles[n] < 0, angles[n], low), np.where(angles[n] < 0, high, angles[n])
        along, across = np.cos(angles) - 1, np.sin(angles)
        fall = rng.standard_exponential((len(starts), chains))
        other = rng.standard_normal((k, chains))
        for b, first in enumerate(starts):
            block, axes = order[first : first + size], other[first : first + size]
            if heavy:  # the variance of the ellipses, given where the chains are
                axes = axes * np.sqrt((FREEDOMS + np.sum(self.state[block] ** 2, axis=0))
                                      / rng.chisquare(FREEDOMS + len(block), chains))
            self._move(block, axes, along[:, b], across[:, b], self.log_density - fall[b], heavy)

    def _move(self, block: NDArray[np.intp], axes: Array, along: Array, across: Array, level: Array,
              heavy: bool) -> None:
        """Move one block (b,) of coordinates of all chains to the first of some places (tries, c) on their ellipses,
        whose second axes are (b, c), at which the log-density is at least a level (c,)."""
        (tries, chains), current, slope = along.shape, self.state[block], self._slope[:, block]
        moved = (current[:, None] + (current[:, None] * along + axes[:, None] * across)).reshape(len(block), -1)
        slack = slope @ moved
        slack.reshape(-1, tries, chains)[:] += (self.slack - slope @ current)[:, None]

        def places() -> Array:
            states = np.tile(self.state, tries)
            states[block] = moved
            return self.inside.places(states)

        new = (self.density.logarithm(slack, places) + self._relative(moved, block)).reshape(tries, chains)
        new += self._relative(self.state) - self._relative(current, block)
        high = new > level if not heavy else new + _over_t(moved).reshape(tries, chains) > level + _over_t(current)
        found = np.flatnonzero(high.any(axis=0))
        pick = np.argmax(high[:, found], axis=0) * chains + found  # the first accepted one
        self.state[np.ix_(block, found)] = moved.take(pick, axis=1)
        self.slack[:, found] = slack.take(pick, axis=1)
        self.log_density[found] = new.ravel()[pick]

    def _relative(self, state: Array, block: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The part (c,) of the log-density that the Gaussian which stands in makes of all states (k, c) or a block."""
        square, linear = (part[block] for part in self._ratio)
        return np.asarray(square @ state**2 + linear @ state)


def _over_t(block: Array) -> Array:
    """Logarithm (...) of a standard normal density of a block (b, ...) over that of Student's t, but for a constant."""
    square = np.sum(block**2, axis=0)
    return np.asarray((FREEDOMS + len(block)) / 2 * np.log1p(square / FREEDOMS) - square / 2)


def _settled(before: Array, now: Array) -> bool:
    """Whether chains (k, c) have neither drifted since `before`, in all a little or in one, nor stayed in place."""
    watched, earlier = (np.vstack([state, np.linalg.norm(state, axis=0)]) for state in (now, before))
    mean, spread = watched.mean(axis=1), np.maximum(watched.std(axis=1), 1e-12)
    drift = np.abs(mean - earlier.mean(axis=1)) / spread
    products = (watched - mean[:, None]) * (earlier - earlier.mean(axis=1)[:, None])
    memory = products.mean(axis=1) / spread / np.maximum(earlier.std(axis=1), 1e-12)
    return bool(np.all(drift < DRIFT) and np.all(memory < MEMORY))


def _pivots(upper: Array) -> Array:
    """Pivots (4, ...) of many symmetric matrices, given by their upper triangles (10, ...).

    All are positive where the matrix is positive definite, and their product then is its determinant.
    """
    a, b, c, d, e, f, g, h, i, j = upper
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # after a failed pivot the rest is invalid
        e, f, g, h, i, j = e - b * b / a, f - b * c / a, g - b * d / a, h - c * c / a, i - c * d / a, j - d * d / a
        h, i, j = h - f * f / e, i - f * g / e, j - g * g / e
        return np.stack([a, e, h, j - i * i / h])


@dataclass(frozen=True)
class _UserConstraints:
    """The user's inequalities ``g(ψ) ≤ 0`` that are not linear, with their slopes, if any."""

    inequality: ca.Function | None
    slopes: ca.Function | None

    def satisfied(self, psi: Array) -> Mask:
        """Whether all inequalities hold (s,) at ψ (s, p)."""
        if self.inequality is None or not len(psi):
            return np.ones(len(psi), dtype=bool)
        return np.asarray(np.all(np.asarray(self.inequality(psi.T)) <= 0, axis=0))

    def slack(self, z: Array, gaussian: GaussianPosterior) -> tuple[Array, Array]:
        """−g (m,) at z (k,), and its slopes (m, k)."""
        if self.inequality is None or self.slopes is None:
            return np.zeros(0), np.zeros((0, len(z)))
        psi = gaussian.offset + gaussian.slope @ z
        return -np.asarray(self.inequality(psi)).ravel(), -np.asarray(self.slopes(psi)) @ gaussian.slope

    def inwards(self, z: Array, gaussian: GaussianPosterior, distance: float) -> Array:
        """z (k,) moved until every inequality is `distance` standard deviations from its edge, to first order."""
        if self.inequality is None or self.slopes is None:
            return z
        for i in range(self.inequality.size1_out(0)):
            psi = gaussian.offset + gaussian.slope @ z
            slope = gaussian.slope.T @ np.asarray(self.slopes(psi))[i]
            size = float(np.linalg.norm(slope)) or 1.0
            excess = float(np.asarray(self.inequality(psi)).ravel()[i]) / size + distance
            z = z - max(excess, 0.0) * slope / size
        return z


def _user_constraints(problem: StatedProblem) -> _UserConstraints | None:
    """The user's constraints in a form that can be sampled.

    None if one cannot be: a nonlinear equality, or a relation that only cvxpy understands.
    """
    parameters = problem.parameters
    psi = ca.SX.sym("psi", len(parameters))
    named = Named(parameters, lambda k: psi[k])
    insides: list[ca.SX] = []
    for constraint in problem.constraints:
        try:
            body, equal = as_casadi(constraint, named)
        except ProblemError:  # its function takes no symbols of CasADi
            return None
        if equal:
            return None
        insides.append(body)
    if not insides:
        return _UserConstraints(None, None)
    g = ca.vertcat(*insides)
    return _UserConstraints(ca.Function("inequality", [psi], [g]),
                            ca.Function("slopes", [psi], [ca.densify(ca.jacobian(g, psi))]))
