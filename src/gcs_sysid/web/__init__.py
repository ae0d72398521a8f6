"""Pages in the browser: analysis of dropped logs, and a session that runs.

`site` serves whom it may; the pages are in `assets`, without a framework and without a build
step. `workbench` takes logs and has `log_worker` analyze them in processes of their own;
`session_page` shows snapshots and passes on what a pilot asks for. Numbers and words are made by
`page_json`, never in the browser; charts are those of the report.
No page has inline script or style. Its colors are those of the themes at the head of `page.css`; a
test checks their contrasts.
"""
