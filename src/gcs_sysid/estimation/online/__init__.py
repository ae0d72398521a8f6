"""The online estimator: when to fit, and what a fit is made of."""
