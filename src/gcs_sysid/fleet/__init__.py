"""Many logs: found, analyzed side by side, kept, put in one table, looked at over time.

`jobs` analyzes one in whatever process of a pool; `batch` finds the logs, keeps results in a
folder and puts them in one Parquet file; `trend` shows it per vehicle. Knows no screen, and
MAVLink only through `session.analysis`.
"""
