"""The report of an analysis: one HTML file that opens anywhere, without a network.

`data` looks on during the analysis, `prediction_series` compares what was measured with what was
predicted, `page_figures` and the sections make a page of it, `files` writes it whole or not at all.
Knows nothing of MAVLink and no screen.
"""
