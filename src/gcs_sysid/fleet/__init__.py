"""Many logs: found, analyzed side by side, kept, put in one table, looked at over time.

`jobs` analyzes one in whatever process, `pools` are the processes, `store` the folder of results;
`batch` finds the logs and ties these together; `batch_table` is the Parquet file of all, `trend`
and `trend_page` show it per vehicle. Knows no screen, and MAVLink only through `session.analysis`.
"""
