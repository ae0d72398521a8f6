"""Pages in the browser: analysis of dropped logs, and a session that runs.

`site` serves and `access` decides who may; the pages are in `assets`, without a framework and
without a build step. `workbench` takes logs and has `log_worker` analyze them in processes of
their own; `session_page` shows snapshots and passes on what a pilot asks for.
"""
