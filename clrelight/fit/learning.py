"""The parameters of `clrelight.fit.zonal`, as the lights of one stack tell them."""

from __future__ import annotations

import numpy as np

from clrelight.fit.evidence import find_end
from clrelight.fit.left_out import (
    FEWEST,
    MOST_PLACES,
    PRIOR_MEAN,
    Learner,
    Moments,
    begin,
    find_clear_limit,
    search_free,
)
from clrelight.fit.places import Places, pick_spread
from clrelight.fit.zonal import LARGEST_DEGREE, Theta


def learn_theta(
    places: Places,
    moments: Moments,
    given: dict[int, float] | None = None,
    limit: int | None = None,
) -> Theta:
    """Return the parameters for these lights and the second moments of what was photographed under them.

    Parameters
    ----------
    places : Places
    moments : Moments
    given : dict of int to float, optional
        Parameters (as `Theta.to_logs` has them) that are known.
    limit : int, optional
        That of `Theta`, where it is known.
    """
    fixed = given or {}
    some = pick_spread(places.directions_g3, MOST_PLACES)
    moments = moments.of(some)
    if not float(np.trace(moments.product_gg)) > 0.0 or len(some) < FEWEST or len(fixed) == len(PRIOR_MEAN):
        return Theta.from_logs(begin(fixed), LARGEST_DEGREE if limit is None else limit)
    chosen = Places(places.directions_g3[some], places.mean_gi[some], places.count_g[some])
    learner = Learner.make(chosen, moments, fixed)
    if limit is not None:
        learner = learner.limited(limit)
    free = search_free(learner)
    ended = None
    if limit is None and not fixed:
        ended = find_clear_limit(learner, free) or find_end(learner, free, chosen, moments)
    return ended or Theta.from_logs(free[1], learner.objective.limit)
