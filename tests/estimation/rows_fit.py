"""Fits to moments of rows written out, without whiteners."""

import numpy as np

from gcs_sysid.estimation.fit.whitened_fit import fit_whitened
from gcs_sysid.estimation.noise.whitening import NONE, WhitenedMoments


def moments_as(batches, counts, noise):
    """(k, 1, width, width) moments as a fit takes them."""
    return WhitenedMoments((batches,), counts, noise, (NONE,), 1.0, 1, np.ones(1))


def fit_rows(batches, counts, basis, noise, prior=None, doubt=0.0):
    """The fit; None where there is none."""
    found = fit_whitened(moments_as(batches, counts, noise), basis, None, prior, doubt)
    return None if found is None else found.rotation
