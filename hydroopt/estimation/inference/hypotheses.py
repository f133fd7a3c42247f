"""Hypotheses about data and model: what each adds to whitened linear least squares, and which of them the data show.

Readings about the point of linearisation are ``r = N·x + H·a + e``: nuisances x with a Gaussian prior, among them all
parameters; amounts a of a hypothesis, ``a ~ N(0, std²)``; and errors e, which are white within a group of rows, with a
variance that is estimated there and is at least the stated one. A hypothesis is weighed by the ratio of the marginal
likelihoods with and without its columns: the log Bayes factor, in nats. Everything follows from inner products of
columns, group by group.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import stdtr

from hydroopt.spatial.inertia import Array

LEVEL = float(np.log(100.0))
"""Log odds that a hypothesis needs [nats]: 100 to 1, where all that are tried are together as likely as none before."""
AGREEMENT = 0.01
"""Chance of the spread of a hypothesis' evidence over the blocks from which on these do not agree that it holds."""
RANGE = 10.0
"""Amounts, in prior standard deviations, beyond which the prior that weighs the evidence is itself refuted."""
MARGIN, ROUGH = 3.0, 0.05
"""Difference of log Bayes factors [nats], and as a part of the largest since variances are estimates, below which two
hypotheses are not told apart."""
MATERIAL = 1.0
"""Shift of a parameter or a claim, over the half width of its 95 % interval, from which on what is stated is wrong."""
BELIEF = 4.0
"""Degrees of freedom that the stated variance counts for in each group: few residuals say little of theirs."""
MOST, CLOSE = 4, 8
"""Hypotheses that are named, one after the other, and those whose evidence is computed exactly at each step."""
NORMAL = 1.645
"""Quantile of the normal distribution at 95 %."""


@dataclass(frozen=True, eq=False)
class Layout:
    """What each row belongs to: (R,) block of the data, (R,) group of equal variance; (G,) number of rows of a group,
    of which transformed rows may count less than one each."""

    block: NDArray[np.intp]
    group: NDArray[np.intp]
    count: Array

    @cached_property
    def members(self) -> list[NDArray[np.intp]]:
        """Rows of each group."""
        return [np.flatnonzero(self.group == g) for g in range(len(self.count))]

    def inner(self, one: Array, other: Array) -> Array:
        """Inner products (G, k, l) of whitened columns (R, k) and (R, l), group by group."""
        return np.stack([one[rows].T @ other[rows] for rows in self.members])


D = TypeVar("D")


@dataclass(frozen=True, kw_only=True)
class Hypothesis(ABC, Generic[D]):
    """One hypothesis about data of a kind D: it is a class in one place, with its columns and its words.

    Attributes:
        name: a short name, by which options mean it; `subject`: channels, actuators, bodies or poses that it is about.
        std: standard deviation of each amount [SI] before the data; as many as it has columns.
        unit: of the size as it is printed, `factor` times the SI size.
        positive: whether its amount cannot be negative.
        linear: whether its effect is linear in the amount; otherwise columns are those about an amount.
        local: whether it concerns so few data that blocks cannot agree on it.
        lack: whether it is an effect that the model lacks: it widens what is stated, and contradicts nothing.
    """

    name: str
    subject: tuple[str, ...]
    std: tuple[float, ...]
    unit: str = ""
    factor: float = 1.0
    positive: bool = False
    linear: bool = True
    local: bool = False
    lack: bool = False

    @abstractmethod
    def columns(self, data: D, amount: Array) -> Array:
        """Change of the predicted readings (..., d) by a unit of each amount, about these amounts (d,) [SI]."""

    @abstractmethod
    def sentence(self, amount: Array) -> str:
        """What it says where it holds with these amounts (d,), without its size."""

    @property
    def remedy(self) -> str:
        """What to do if it holds."""
        return ""

    def size(self, amount: Array) -> float:
        """Size of its amounts (d,) [SI]."""
        return float(amount[0]) if len(self.std) == 1 else float(np.linalg.norm(amount))


H = TypeVar("H", bound=Hypothesis[Any])


@dataclass(frozen=True, eq=False)
class Found(Generic[H]):
    """What the data say of a hypothesis.

    Attributes:
        amount, covariance: (d,) and (d, d) of its amounts [SI] after the data.
        evidence: log Bayes factor against its absence [nats].
        agreement: p-value of its absence by the scatter of the blocks' evidence alone.
        elsewhere: part of the evidence that is not that of the block which shows it most.
        shift: (P,) by which the nuisances move if it is corrected.
        rivals: hypotheses that explain as much, the best first.
    """

    hypothesis: H
    amount: Array
    covariance: Array
    evidence: float
    agreement: float
    elsewhere: float
    shift: Array
    rivals: tuple[Found[H], ...] = ()

    @property
    def size(self) -> float:
        """Size of its amounts [SI]."""
        return self.hypothesis.size(self.amount)

    @property
    def std(self) -> float:
        """Standard deviation of the size [SI]."""
        along = self.amount / np.maximum(np.linalg.norm(self.amount), 1e-300)
        return float(np.sqrt(np.maximum(along @ self.covariance @ along, 0.0)))

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the size [SI]."""
        return self.size - 1.96 * self.std, self.size + 1.96 * self.std

    def moves(self, sums: Array, width: Array) -> float:
        """Largest shift of stated sums (m, P) of the nuisances, over the half widths (m,) of their 95 % intervals."""
        return float(np.max(np.abs(sums @ self.shift) / width, initial=0.0))

    def shown(self, tried: Sequence[H]) -> bool:
        """Whether the data show it, where these were tried, of which some share its name: the one rule of decision."""
        alike = sum(each.name == self.hypothesis.name for each in tried)
        within = np.all(np.abs(self.amount) <= RANGE * np.array(self.hypothesis.std))
        sign = not self.hypothesis.positive or self.size > 0
        agree = self.hypothesis.local or (
            self.agreement < AGREEMENT / alike and self.evidence * self.elsewhere > LEVEL)
        return bool(within and sign and agree and self.evidence > needed(len(tried)))


def needed(tried: int) -> float:
    """Log Bayes factor [nats] that one of so many hypotheses needs."""
    return LEVEL + float(np.log(max(tried, 1)))


class Fit(NamedTuple):
    """Most probable x (P,), its covariance (P, P), variances (G,) of the groups, and the log marginal likelihood."""

    x: Array
    covariance: Array
    variance: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class LinearModel(Generic[H]):
    """Whitened readings about a point of linearisation; hypotheses that hold are the last of the nuisances.

    Attributes:
        nuisances, residual: columns N (R, P) and r (R,).
        layout: what the rows belong to.
        products, scores, squares: NᵀN (G, P, P), Nᵀr (G, P) and rᵀr (G,), group by group.
        prior: (P, P) information about x; `pull` (P,) that information times the prior's mean.
        about: (a,) amounts about which the hypotheses that hold are linearised, side by side.
        constant: log density of the priors of their amounts, as far as x does not change it.
    """

    nuisances: Array
    residual: Array
    layout: Layout
    products: Array
    scores: Array
    squares: Array
    prior: Array
    pull: Array
    about: Array
    constant: float = 0.0

    @classmethod
    def of(cls, nuisances: Array, residual: Array, layout: Layout, prior: Array, pull: Array) -> LinearModel[H]:
        """The model in which no hypothesis holds."""
        r = residual[:, None]
        return cls(nuisances, residual, layout, layout.inner(nuisances, nuisances), layout.inner(nuisances, r)[:, :, 0],
                   layout.inner(r, r)[:, 0, 0], prior, pull, np.zeros(0))

    def holding(self, hypothesis: H, columns: Array, about: Array | None = None) -> LinearModel[H]:
        """The same with one hypothesis more, of columns (R, d); the residual is that about its amounts `about`, by
        default zero."""
        std, inner = np.array(hypothesis.std), self.layout.inner
        amount = np.zeros(len(std)) if about is None else about
        cross = inner(self.nuisances, columns)
        P = len(self.prior)
        prior = np.zeros((P + len(std), P + len(std)))
        prior[:P, :P], prior[P:, P:] = self.prior, np.diag(std**-2.0)
        return replace(
            self, nuisances=np.hstack([self.nuisances, columns]),
            products=np.block([[self.products, cross], [np.swapaxes(cross, 1, 2), inner(columns, columns)]]),
            scores=np.concatenate([self.scores, inner(columns, self.residual[:, None])[:, :, 0]], axis=1), prior=prior,
            pull=np.append(self.pull, -amount / std**2), about=np.append(self.about, amount),
            constant=self.constant - float(np.sum(np.log(std)) + 0.5 * np.sum((amount / std) ** 2)))

    @cached_property
    def fit(self) -> Fit:
        """Most probable nuisances; variances by restricted maximum likelihood, weakly believed to be as stated."""
        products, scores, squares, count = self.products, self.scores, self.squares, self.layout.count
        variance = np.ones(len(count))
        for _ in range(20):  # steps shrink by half or more; what is left changes no nat
            weight = 1 / variance
            information = np.tensordot(weight, products, 1) + self.prior
            scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
            factor = cho_factor(scale[:, None] * information * scale + 1e-12 * np.eye(len(scale)), lower=True)
            covariance = scale[:, None] * cho_solve(factor, np.diag(scale))
            x = covariance @ (weight @ scores + self.pull)
            left = np.maximum(squares - 2 * scores @ x + (products @ x) @ x, 0.0)
            taken = weight * np.tensordot(products, covariance)
            last, variance = variance, np.maximum((BELIEF + left) / (BELIEF + np.maximum(count - taken, 0.0)), 1.0)
            if np.all(np.abs(np.log(variance / last)) < 1e-3):
                break
        determinant = 2 * float(np.sum(np.log(np.diag(factor[0])) - np.log(scale)))
        likelihood = -0.5 * float(np.sum((count + BELIEF) * np.log(last) + (left + BELIEF) / last))
        evidence = likelihood + self.constant - 0.5 * (float(x @ self.prior @ x - 2 * self.pull @ x) + determinant)
        return Fit(x, covariance, last, evidence)

    def found(self, hypothesis: H, without: LinearModel[H], place: int = -1) -> Found[H]:
        """What the data say of a hypothesis that holds here and not in another model; its amounts begin at `place` of
        all, by default they are the last."""
        d, held, fit = len(hypothesis.std), len(self.about), self.fit
        place = held - d if place < 0 else place
        own = np.arange(d) + len(fit.x) - held + place
        amount, covariance = self.about[place : place + d] + fit.x[own], fit.covariance[np.ix_(own, own)]
        # what is left of its columns beside all others, times the amounts, and its products with the residual
        alone = self.nuisances @ (fit.covariance[:, own] @ np.linalg.solve(covariance, amount))
        weighted = alone / fit.variance[self.layout.group]
        expected, scatter = (np.bincount(self.layout.block, weighted * each).astype(float)
                             for each in (alone, self.residual - self.nuisances @ fit.x))
        elsewhere = 1 - float(np.max(expected)) / max(float(np.sum(expected)), 1e-300)
        P = len(fit.x) - held
        return Found(hypothesis, amount, covariance, fit.evidence - without.fit.evidence,
                     _agreement(expected, scatter), elsewhere, fit.x[:P] - without.fit.x[:P])

    def screened(self, hypotheses: Sequence[H], columns: Array) -> Array:
        """Log Bayes factor (k,) of each hypothesis alone, by columns (R, …) side by side, at the variances without it.
        """
        return np.array([0.5 * (toward @ np.linalg.solve(np.eye(len(toward)) + information, toward)
                                - np.linalg.slogdet(np.eye(len(toward)) + information)[1])
                         for information, toward in self._alone(hypotheses, columns)])

    def smallest(self, hypotheses: Sequence[H], columns: Array) -> list[float]:
        """Size [SI] of each that would have been shown with a probability of 95 %, along its best visible direction."""
        made = []
        for each, (information, _) in zip(hypotheses, self._alone(hypotheses, columns), strict=True):
            best = max(float(np.linalg.eigvalsh(information)[-1]), 1e-300)
            drop = 2 * needed(len(hypotheses)) + np.log1p(best)
            made.append(float((np.sqrt(drop) + NORMAL) / np.sqrt(best) * np.max(each.std)))
        return made

    def _alone(self, hypotheses: Sequence[H], columns: Array) -> Iterator[tuple[Array, Array]]:
        """Information (d, d) about each hypothesis' amounts over their stds, and its part of the residual (d,)."""
        weighted = columns / self.fit.variance[self.layout.group, None]
        cross = self.nuisances.T @ weighted
        known, toward = self.fit.covariance @ cross, weighted.T @ self.residual - cross.T @ self.fit.x
        first = 0
        for each in hypotheses:
            std, own = np.array(each.std), slice(first, first + len(each.std))
            information = columns[:, own].T @ weighted[:, own] - cross[:, own].T @ known[:, own]
            yield np.outer(std, std) * information, std * toward[own]
            first += len(std)


def _agreement(expected: Array, scatter: Array) -> float:
    """p-value of Student's t of all blocks' evidence, by how that of single blocks scatters about what is expected."""
    sound = expected > 1e-3 * np.max(expected, initial=0.0)
    blocks = int(np.sum(sound))
    if blocks < 3:
        return 1.0
    spread = np.sqrt(np.sum(scatter[sound] ** 2) * blocks / (blocks - 1))
    return float(2 * stdtr(blocks - 1, -np.sum(expected[sound]) / max(spread, 1e-300)))


class Readings(Protocol[H]):
    """Data that can be linearised about hypotheses that hold, each with its amounts."""

    def model(self, held: Sequence[tuple[H, Array]]) -> LinearModel[H]:
        """The model about these."""

    def columns(self, hypotheses: Sequence[H], held: Sequence[tuple[H, Array]]) -> Array:
        """Columns (R, …) of other hypotheses there, about amounts of zero, side by side."""


def name(data: Readings[H], candidates: Sequence[H]) -> tuple[Found[H], ...]:
    """The hypotheses that the data show, the likeliest first, each with those that explain as much.

    They are added one by one; data are linearised anew about all of them, and one that is shown no more goes again.
    """
    found: list[Found[H]] = []
    left = list(candidates)
    while len(found) < MOST and (step := _leading(data, left, found, candidates)) is not None:
        left.remove(step.hypothesis)
        found = judged(data, [*found, step])
        while lost := [each for each in found if not each.shown(candidates)]:
            found = judged(data, [each for each in found if each is not min(lost, key=lambda one: one.evidence)])
    named = {id(each.hypothesis) for each in found}  # what holds beside it is no rival
    return tuple(replace(each, rivals=tuple(one for one in each.rivals if id(one.hypothesis) not in named))
                 for each in found)


def judged(data: Readings[H], found: Sequence[Found[H]]) -> list[Found[H]]:
    """Hypotheses with their amounts together, each weighed against its absence."""
    held = [(each.hypothesis, each.amount) for each in found]
    places = np.cumsum([0, *(len(each.std) for each, _ in held)]).tolist()
    for _ in range(2 if any(not each.linear for each, _ in held) else 1):
        model = data.model(held)
        amounts = model.about + model.fit.x[len(model.fit.x) - len(model.about) :]
        held = [(each, amounts[a:b]) for (each, _), a, b in zip(held, places[:-1], places[1:], strict=True)]
    model = data.model(held)
    return [replace(model.found(each.hypothesis, data.model(held[:k] + held[k + 1 :]), places[k]), rivals=each.rivals)
            for k, each in enumerate(found)]


def _leading(data: Readings[H], candidates: Sequence[H], found: Sequence[Found[H]],
             tried: Sequence[H]) -> Found[H] | None:
    """The likeliest hypothesis beside those found, with its rivals, if the data show it."""
    held = [(each.hypothesis, each.amount) for each in found]
    model, columns = data.model(held), data.columns(candidates, held)
    screened, places = model.screened(candidates, columns), np.cumsum([0, *(len(each.std) for each in candidates)])
    close = [model.holding(candidates[k], columns[:, places[k] : places[k + 1]]).found(candidates[k], model)
             for k in np.argsort(-screened)[:CLOSE].tolist() if screened[k] > LEVEL]
    exact = {id(each.hypothesis) for each in close if each.hypothesis.linear}
    while True:
        shown = sorted((each for each in close if each.shown(tried)), key=lambda each: -each.evidence)
        if not shown:
            return None
        if id(shown[0].hypothesis) in exact:
            break
        close[close.index(shown[0])] = judged(data, [*found, shown[0]])[-1]  # others lead only by what they are alone
        exact.add(id(shown[0].hypothesis))
    near = shown[0].evidence - max(MARGIN, ROUGH * shown[0].evidence)
    return replace(shown[0], rivals=tuple(each for each in shown[1:] if each.evidence > near))
