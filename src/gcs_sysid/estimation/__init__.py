"""From samples to parameters, one room a step.

`rows` are made of samples and `noise` whitens them; `fit` finds what explains them and `checks`
doubts it. `record` keeps the rows of a flight and `online` decides when to fit. `parameters` gives
a fit its scale, intervals and statuses; `changes` asks whether the vehicle is still the same;
`offline` sees the whole flight at once. Imports go that way only, as an import contract says.
"""
