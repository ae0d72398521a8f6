"""The report of an analysis: one HTML file that opens anywhere, without a network.

`data` looks on during the analysis and compares what was measured with what was predicted,
`page_figures` and the sections make a page of it.
Knows nothing of MAVLink and no screen.
"""
