"""The result of an identification, as files, screens and reports take it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.parameters import INERTIA
from gcs_sysid.model.rigid_body import inertia_matrix
from gcs_sysid.results.result_data import ResultData

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from gcs_sysid.model.flight_model import FlightModel
    from gcs_sysid.results.notebook_view import PlotKind
    from gcs_sysid.results.parameter_samples import ParameterSamples


@dataclass(frozen=True, repr=False)
class Result(ResultData):
    """The complete result of an identification at one instant.

    Example:
        >>> import gcs_sysid
        >>> result = gcs_sysid.analyze("logs/sample.tlog", "paper")
        >>> [name for name, e in result.parameters.items() if e.status == "weak"]
        ['linear_drag']
        >>> result.scale.anchor, result.as_json()["parameters"]["mass"]["unit"]
        ('mass', 'kg')
    """

    @property
    def inertia(self) -> Array:
        """(3, 3) matrix about the CG in kg m^2, axes forward, right, down; NaN where not known.

        Example:
            >>> import gcs_sysid
            >>> gcs_sysid.analyze("logs/sample.tlog", "paper").inertia.shape
            (3, 3)
        """
        known = [self.parameters.get(name) for name in INERTIA]
        values = [np.nan if e is None or e.value is None else e.value for e in known]
        return inertia_matrix(np.array(values))

    def samples(self, n: int, seed: int = 0, *, given: bool = True) -> "ParameterSamples":
        """Vehicles drawn from the full covariance, all of them physical; see `draw_samples`.

        Args:
            n: vehicles.
            seed: of the random numbers.
            given: whether errors of arm, scale and IMU as given are drawn too; without them the
                samples show what this vehicle's motion may differ by.

        Raises:
            InputError: there is no covariance, or hardly any draw is physical.

        Example:
            >>> import gcs_sysid
            >>> samples = gcs_sysid.analyze("logs/sample.tlog", "paper").samples(500, seed=1)
            >>> samples["Izz"].shape, bool(abs(samples["Izz"].mean() - 0.0294) < 0.001)
            ((500,), True)
        """
        from gcs_sysid.results.parameter_samples import draw_samples

        return draw_samples(self, n, seed, given=given)

    def model(self, samples: "ParameterSamples | None" = None) -> "FlightModel":
        """Equations of motion with these values: `model().simulate(t, rotors, initial)`.

        Args:
            samples: an ensemble from `samples`; None: the estimate itself.

        Raises:
            InputError: the result lacks a parameter without which the model cannot fly.
        """
        from gcs_sysid.results.parameter_samples import flight_model

        return flight_model(self, samples)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row per parameter and timing value.

        Raises:
            InputError: pandas is not installed.
        """
        from gcs_sysid.results.notebook_view import dataframe

        return dataframe(self)

    def plot(self, kind: "PlotKind | None" = None) -> "Figure":
        """Draw `convergence`, `correlation` or `prediction`; by default all there is to draw.

        Raises:
            InputError: matplotlib is not installed, or the result does not hold what is wanted.
        """
        from gcs_sysid.results.notebook_view import plot

        return plot(self, kind)

    def __repr__(self) -> str:
        """One screen of text."""
        from gcs_sysid.results.notebook_view import text

        return text(self)

    def _repr_html_(self) -> str:
        from gcs_sysid.results.notebook_view import html

        return html(self)
