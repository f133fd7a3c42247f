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
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hydroopt.errors import ProblemError
from hydroopt.estimation.inference import convex_program, elliptical_moves
from hydroopt.estimation.inference.barrier import Interior, Matrices, interior
from hydroopt.estimation.inference.conditions import MARGIN, UPPER, Condition
from hydroopt.estimation.inference.constraints import Named, as_casadi
from hydroopt.estimation.inference.problem import InferenceProblem
from hydroopt.estimation.inference.truncated import Marginal, TruncatedGaussian, of_samples
from hydroopt.estimation.inference.whitening import GaussianPosterior, gaussian_posterior
from hydroopt.spatial.inertia import Array

Mask = NDArray[np.bool_]

CHAINS, WARM_UP, SWEEPS, APART = 128, 30, 10, 2
"""Number of chains; sweeps of a warm-up and after which places are kept; how many sweeps apart these are at least:
chains remember their places for about eight, and what is made of places takes longer than a sweep."""

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
class Drawn:
    """Samples (s, p) of the parameters; where nothing but a Gaussian is cut off, also that Gaussian, with the slack
    (m, s) of its conditions at the samples."""

    samples: Array
    truncated: tuple[TruncatedGaussian, Array] | None

    def marginal(self, rows: Array) -> Marginal:
        """Distributions of linear sums (k, p) of the parameters."""
        if self.truncated is not None:
            return self.truncated[0].marginal(self.samples, self.truncated[1], rows, CHAINS)
        return of_samples(rows @ self.samples.T, CHAINS)


@dataclass(frozen=True, eq=False)
class Posterior:
    """What samples say of the parameters one by one, their mean (p,), and how they were drawn in words.

    `mean` is None where the mean of possible parameters is not itself possible: constraints that are not convex.
    `converged` tells whether the chains reached their stationary distribution.
    """

    drawn: Drawn
    own: Marginal
    mean: Array | None
    note: str
    converged: bool = True

    @property
    def samples(self) -> Array:
        """Those (s, p) of the parameters."""
        return self.drawn.samples

    def interval(self, rows: Array | None = None) -> tuple[Array, Array]:
        """Standard deviation (k,) and 95 % interval (k, 2) of the parameters, or of linear sums of them (k, p)."""
        if rows is None:
            return self.own.std.copy(), self.own.interval.copy()
        alone = (np.count_nonzero(rows, axis=1) == 1) & (np.max(rows, axis=1, initial=0.0) == 1)
        at = np.argmax(rows[alone], axis=1)
        std, interval = np.empty(len(rows)), np.empty((len(rows), 2))
        std[alone], interval[alone] = self.own.std[at], self.own.interval[at]
        _, std[~alone], interval[~alone], _ = self.drawn.marginal(rows[~alone])
        return std, interval


def sample(problem: InferenceProblem, R: Array, r: Array, psi: Array, *, consistent: bool,
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
    if user is None:
        return None
    gaussian = gaussian_posterior(problem, R, r).conditioned_on(conditions)
    if gaussian is None:
        return None
    inequalities = _Inequalities(problem, gaussian, user, conditions, Interior.of(len(gaussian.slope.T)))
    inside = interior(_possible_points(problem, gaussian, user, inequalities, psi, consistent=consistent),
                      gaussian.root, gaussian.right, inequalities.matrices, inequalities.single)
    if inside is None:
        return None
    rng = np.random.default_rng(seed)
    chains = _Chains.standing_in(inequalities.about(inside), rng)
    settled, earlier = False, list[Array]()
    for warm_ups in range(1, ROUNDS + 1):
        for _ in range(2):
            chains = chains.refitted()
            earlier.append(chains.whitened)
            for _ in range(WARM_UP // 2):
                chains.sweep(rng)
        settled = _settled(chains.states(earlier[warm_ups]), chains.state)
        if settled:
            break
    kept, states, slack = [], [], []
    for _ in range(SWEEPS):  # as far apart as it takes these chains to forget their places
        for _ in range(APART * (warm_ups if settled else 1)):
            chains.sweep(rng)
        kept.append(chains.parameters)
        states.append(chains.state.copy())
        slack.append(chains.slack.copy())
    samples = np.concatenate(kept)
    gaussian_alone = not inequalities.heavy_tailed and user.inequality is None
    drawn = Drawn(samples, (TruncatedGaussian(gaussian, inequalities.slope, inequalities.matrix_count),
                            np.concatenate(slack, axis=1)) if gaussian_alone else None)
    own = drawn.marginal(np.eye(samples.shape[1]))
    bent = "Gaussian posterior" if problem.distance == "gaussian" else "posterior with log-det distances"
    note = (f"intervals from the {bent} cut off by bounds and constraints: {len(samples)} samples by "
            "elliptical slice sampling" + (f"; standard errors of their widths up to {100 * error:.2g} %"
                                           if (error := float(np.max(own.error, initial=0.0))) > COARSE else "")
            + ("" if settled else ", which did not converge"))
    # not the more exact means one by one: each has its own error, and sums are known far better than parts
    possible = chains.inequalities.possible(np.mean(states, axis=(0, 2)))
    return Posterior(drawn, own, samples.mean(axis=0) if possible else None, note, settled)


def _possible_points(problem: InferenceProblem, gaussian: GaussianPosterior, user: _UserConstraints,
                     inequalities: _Inequalities, psi: Array, *, consistent: bool) -> Iterator[Array]:
    """Points z (k,) inside: the nominal parameters, a little away from bounds, and one near the estimate ψ, which takes
    longer to find."""
    parameters = problem.parameters
    away = np.minimum(0.1 * parameters.scale, 0.25 * (parameters.upper - parameters.lower))
    nominal = np.clip(parameters.nominal, parameters.lower + away, parameters.upper - away)
    # in the Gaussian's coordinates; what leaves the equalities is dropped
    slope, offset = gaussian.slope / parameters.scale[:, None], gaussian.offset
    stated, start = np.linalg.lstsq(slope, ((np.stack([nominal, psi]) - offset) / parameters.scale).T, rcond=None)[0].T
    if inequalities.possible(stated):
        yield np.asarray(stated)
    for distance in (1e-1, 1e-2, 1e-3):
        inner = convex_program.inner_point(problem, gaussian, start, consistent=consistent, margin=1e-3 * distance)
        if inner is not None and inequalities.possible(inner := user.inwards(inner, gaussian, distance)):
            yield inner
            return


@dataclass(frozen=True, eq=False)
class _Chains:
    """States (k, c) of all chains, with their slack (m, c) and log-density (c,), which each sweep changes in place."""

    inequalities: _Inequalities
    state: Array
    slack: Array
    log_density: Array

    @classmethod
    def at(cls, inequalities: _Inequalities, state: Array) -> _Chains:
        """Chains at possible states (k, c)."""
        slack = inequalities.slack(state)
        return cls(inequalities, state, slack, inequalities.log_density(slack, lambda: state))

    @classmethod
    def standing_in(cls, inequalities: _Inequalities, rng: np.random.Generator) -> _Chains:
        """Chains that begin as the Gaussian that stands in, moved towards its centre where that is not possible."""
        return cls.at(inequalities, inequalities.first(rng.standard_normal((inequalities.slope.shape[1], CHAINS))))

    @property
    def parameters(self) -> Array:
        """ψ (c, p)."""
        gaussian = self.inequalities.gaussian
        return np.asarray(gaussian.offset + (gaussian.slope @ self.state).T)

    @property
    def whitened(self) -> Array:
        """Places z (k, c) in the coordinates in which the Gaussian that is cut off is standard normal."""
        centre, root = self.inequalities.inside
        return np.asarray(centre[:, None] + root @ self.state)

    def states(self, z: Array) -> Array:
        """States (k, c) of other places z (k, c) in the coordinates of these chains."""
        centre, root = self.inequalities.inside
        return np.asarray(root.T @ (z - centre[:, None]) / np.sum(root**2, axis=0)[:, None])

    def refitted(self) -> _Chains:
        """The same chains about a Gaussian with their mean, and wider where they are, so that they move far."""
        mean, width = self.state.mean(axis=1), np.maximum(WIDER * self.state.std(axis=1), 1.0)
        return _Chains.at(self.inequalities.about(self.inequalities.inside.moved(mean, width)),
                          (self.state - mean[:, None]) / width[:, None])

    def sweep(self, rng: np.random.Generator) -> None:
        """Move every coordinate of every chain once."""
        elliptical_moves.sweep(self.inequalities, self.state, self.slack, self.log_density, rng)


def _settled(before: Array, now: Array) -> bool:
    """Whether chains (k, c) have neither drifted since `before`, in all a little or in one, nor stayed in place."""
    watched, earlier = (np.vstack([state, np.linalg.norm(state, axis=0)]) for state in (now, before))
    mean, spread = watched.mean(axis=1), np.maximum(watched.std(axis=1), 1e-12)
    drift = np.abs(mean - earlier.mean(axis=1)) / spread
    products = (watched - mean[:, None]) * (earlier - earlier.mean(axis=1)[:, None])
    memory = products.mean(axis=1) / spread / np.maximum(earlier.std(axis=1), 1e-12)
    return bool(np.all(drift < DRIFT) and np.all(memory < MEMORY))


class _Inequalities:
    """All inequalities as functions of the Gaussian's coordinates z; a column each chain.

    Their slack (m, c), of the linear ones and of the entries of matrices, is updated cheaply by each step.
    """

    def __init__(self, problem: InferenceProblem, whitened: GaussianPosterior, user: _UserConstraints,
                 conditions: Sequence[Condition], inside: Interior) -> None:
        gaussian = whitened.moved(*inside)
        self._whitened, self._problem, self._conditions = whitened, problem, conditions
        matrices = [c for c in conditions if c.kind == "semidefinite"]
        linear = [c for c in conditions if c.kind == "nonnegative"]
        weights = {body.consistency: body.weight for body in problem.bodies}
        self._all_weights = np.array([weights.get(c.name, 0.0) for c in matrices])
        self._distant = np.flatnonzero(self._all_weights)
        self._weights = self._all_weights[self._distant]
        self._spread = np.array([body.spread for body in problem.bodies if body.weight])
        self.matrix_count = len(matrices)
        # first entries of all matrices, second entries, ..., then the linear ones
        order = np.arange(10 * len(matrices)).reshape(-1, 10).T.ravel()
        p = len(problem.parameters)
        rows = np.vstack([np.zeros((0, p)), *(c.rows for c in matrices)])[order]
        right = np.concatenate([np.zeros(0), *(c.right + MARGIN / 2 * (UPPER[0] == UPPER[1]) for c in matrices)])[order]
        gradient = np.vstack([rows, *(c.rows for c in linear)])
        self.slope = gradient @ gaussian.slope
        self.start = gradient @ gaussian.offset - np.concatenate([right, *(c.right for c in linear)])
        self._user = user
        self.gaussian = gaussian
        self.inside = inside
        self._ratio = inside.ratio

    @property
    def heavy_tailed(self) -> bool:
        """Whether log-det distances make the density fall like an exponential, not like a Gaussian."""
        return bool(self._distant.size)

    def about(self, inside: Interior) -> _Inequalities:
        """The same in the coordinates of a Gaussian that stands in for the posterior."""
        return _Inequalities(self._problem, self._whitened, self._user, self._conditions, inside)

    def matrices(self, z: Array) -> Matrices:
        """All matrices at z (k,)."""
        rows = 10 * self.matrix_count
        return Matrices(self.slack(z[:, None])[:rows].reshape(10, -1).T,
                        self.slope[:rows].reshape(10, self.matrix_count, len(z)).swapaxes(0, 1), self._all_weights)

    def single(self, z: Array) -> tuple[Array, Array]:
        """All other inequalities (m,) at z (k,), and their slopes (m, k)."""
        rows = 10 * self.matrix_count
        value, slope = self._user.slack(z, self.gaussian)
        return np.append(self.slack(z[:, None])[rows:, 0], value), np.vstack([self.slope[rows:], slope])

    def possible(self, z: Array) -> bool:
        """Whether all inequalities hold at z (k,)."""
        column = z[:, None]
        return bool(self.log_density(self.slack(column), lambda: column)[0] > -np.inf)

    def first(self, state: Array) -> Array:
        """States (k, c), moved towards the centre as far as they must be to be possible."""
        while np.any(outside := self.log_density(self.slack(state), partial(np.asarray, state)) == -np.inf):
            state = np.where(outside, NEARER * state, state)
        return state

    def slack(self, state: Array) -> Array:
        """The linear functions (m, c) of the states z (k, c)."""
        return np.asarray(self.start[:, None] + self.slope @ state)

    def log_density(self, slack: Array, state: Callable[[], Array]) -> Array:
        """Logarithm (c,) of the posterior's density relative to that of standard normal states, −∞ where an inequality
        does not hold.
        """
        return self.truncated(slack, state) + self.ratio(state())

    def truncated(self, slack: Array, state: Callable[[], Array]) -> Array:
        """The part (c,) of `log_density` that inequalities and log-det distances make."""
        good: Mask = np.all(slack[10 * self.matrix_count :] >= 0, axis=0)
        correction = np.zeros(len(good))
        if self.matrix_count:
            entries = slack[: 10 * self.matrix_count].reshape(10, self.matrix_count, -1)
            pivots = _pivots(entries)
            good &= np.all(pivots > 0, axis=(0, 1))
            if self._distant.size:
                correction[good] = self._log_det_correction(*(part[:, self._distant][..., good]
                                                              for part in (entries, pivots)))
        if self._user.inequality is not None:
            good[good] = self._user.satisfied(self.gaussian.offset + (self.gaussian.slope @ state()[:, good]).T)
        return np.where(good, correction, -np.inf)

    def ratio(self, state: Array, block: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The part (c,) of `log_density` that the Gaussian which stands in makes of all states (k, c) or a block."""
        square, linear = (part[block] for part in self._ratio)
        return np.asarray(square @ state**2 + linear @ state)

    def _log_det_correction(self, entries: Array, pivots: Array) -> Array:
        """What log-det distances of the matrices W (10, b, c) weigh beyond the Gaussian that stands in for them."""
        diagonal = UPPER[0] == UPPER[1]
        mean = self._spread[:, None]
        square = np.sum((entries[diagonal] - mean) ** 2, axis=0) + 2 * np.sum(entries[~diagonal] ** 2, axis=0)
        distance = np.sum(entries[diagonal], axis=0) - np.sum(np.log(pivots), axis=0)
        return np.asarray(self._weights @ (square / mean / 4 - distance / 2))


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


def _user_constraints(problem: InferenceProblem) -> _UserConstraints | None:
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
        except (ProblemError, TypeError, ValueError, NotImplementedError):  # what cvxpy raises at CasADi symbols
            return None
        if equal:
            return None
        insides.append(body)
    if not insides:
        return _UserConstraints(None, None)
    g = ca.vertcat(*insides)
    return _UserConstraints(ca.Function("inequality", [psi], [g]),
                            ca.Function("slopes", [psi], [ca.densify(ca.jacobian(g, psi))]))
