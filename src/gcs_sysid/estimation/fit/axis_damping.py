"""What damping that differs by axis does to a fit of window rows, which have one for all three.

Yaw alone determines the ratio of its damping to Izz, and roll and pitch their damping. One damping
for all of them ties Izz to Ixx and Iyy more closely than gyroscopic torque does; but inflow and
flapping damp roll and pitch, and hardly yaw; and with slow samples a torque that seems late is
taken for damping. Rows of one step have damping by axis among their
unknowns (`deviations`). In the window's, with phi its difference from the common one and
D = dQ/dphi x, as for what is given (`estimation.parameters.given_errors`),

    H = sum G' W G,  C = sum G' W D,  S = (H + L)^-1 C
    I = sum D' W D - C' S,   g = sum D' W r - S' (sum G' W r + L (mean - theta))
    P = (I / f + 1 / sigma^2)^-1,   phi = P g / f

with L the prior's information, and f the factor by which colored residuals widen the covariance of
theta. The fit leaves phi out, so it errs by -S phi, with the expected square S (P + phi phi') S'.
With commands sigma is the usual one; with speeds that of most evidence (`deviations`), and none
where evidence is against any.
"""

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.fit.deviations import AXIS_DAMPING, SIZES, evidence_for
from gcs_sysid.estimation.fit.priors import Prior
from gcs_sysid.estimation.fit.problem import N_X, residual_maker
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.fit.solver import scales
from gcs_sysid.estimation.noise.uncertainty import symmetric_roots
from gcs_sysid.model import rigid_body as rb

_KNOWN_TO = 0.2
"""Of a moment of inertia: those known better show how much colored residuals widen intervals."""
_OF_AXES = np.zeros((3, 3, rb.N_SIGNALS))
"""What the damping of each axis adds to B of J w' = B x."""
for _axis, _rate in enumerate("pqr"):
    _OF_AXES[_axis, _axis, rb.SIGNALS.index(_rate)] = -1.0


def axis_damping_doubt(
    fit: RotationFit, rows: Array, prior: Prior | None = None, *, commands: bool
) -> Array:
    """(N_THETA, N_THETA) covariance of the error that one damping for three axes makes.

    Args:
        fit: of rows of the window.
        rows: (WIDTH, WIDTH) moments of rows [x, y] at its coordinates, without known noise.
        prior: of the fit.
        commands: whether they are the input: damping then always may differ, as in
            `DeviationChoice`; with speeds only as much as the flight shows.
    """
    theta = fit.theta
    W = np.linalg.inv(fit.residual_covariance)
    Q, G = rb.forward_jacobian(theta)
    D = np.linalg.inv(rb.inertia_matrix(theta)) @ _OF_AXES
    inputs = rows[:N_X, :N_X]
    left = W @ (residual_maker(Q) @ rows)[:, :N_X]  # W r x'
    weighted = W @ G @ inputs
    H = np.einsum("kaz,laz->kl", weighted, G)
    C = np.einsum("kaz,saz->ks", weighted, D)
    inverse = _inverse(H)
    pull = np.einsum("kax,ax->k", G, left)
    S = inverse @ C
    if prior is not None:
        n = rb.N_THETA
        S = _inverse(H + prior.information[:n, :n]) @ C
        pull = pull + prior.pull(fit.unknowns)[:n]
    own = np.einsum("saz,taz->st", W @ D @ inputs, D) - C.T @ S
    g = np.einsum("sax,ax->s", D, left) - S.T @ pull
    moments = np.abs(theta[rb.MOMENTS])
    white = np.sqrt(np.diag(inverse))
    known = np.zeros(rb.N_THETA, dtype=bool)
    known[rb.MOMENTS] = fit.data_std[rb.MOMENTS] < _KNOWN_TO * moments
    if not known.any():
        return np.zeros((rb.N_THETA, rb.N_THETA))
    f = max(float(((fit.data_std / white)[known] ** 2).max()), 1.0)
    # As usual, or as much as there is: an axis may be damped twice as much, or not at all.
    sigma = np.hypot(AXIS_DAMPING * moments, theta[rb.DAMPING])
    if not commands:
        sizes = [size * moments for size in SIZES["damping"]]
        evidence = [evidence_for(g / f, own / f, size) for size in sizes]
        if max(evidence) < 0.0:
            return np.zeros((rb.N_THETA, rb.N_THETA))
        sigma = sizes[int(np.argmax(evidence))]
    scaled = own / f * np.outer(sigma, sigma)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    P = (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T * np.outer(sigma, sigma)
    phi = P @ g / f
    doubt: Array = S @ (P + np.outer(phi, phi)) @ S.T
    return doubt


def _inverse(information: Array) -> Array:
    d = scales(information)
    root = symmetric_roots(information / np.outer(d, d))[1]
    inverse: Array = root @ root / np.outer(d, d)
    return inverse
