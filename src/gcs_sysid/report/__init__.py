"""The report of an analysis: one HTML file that opens anywhere, without a network.

`recorder` looks on during the analysis, `prediction` compares what was measured with what was
predicted, `figures` and the sections make a page of it, `files` writes it whole or not at all.
Knows nothing of MAVLink and no screen.
"""
