"""The folder of a batch: a file for every finished log, named so that it is found again."""

import json
import re
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.files import log_file, read_text, write_whole
from gcs_sysid.fleet.jobs import FAILURE, Document, Task
from gcs_sysid.results.result_data import SCHEMA
from gcs_sysid.results.result_file import MOST_BYTES
from gcs_sysid.strict_json import json_text

RESULTS = "results"
TABLE = "fleet.parquet"
_NAME = re.compile(r".*-([0-9a-f]{16})\.json")


class Store:
    """Documents by the key of their task.

    A file is there whole or not at all, and its name holds the key of content and settings: what
    is there is done, whenever and however the program ended.

    Args:
        folder: of the batch; made if need be.
        force: whether nothing that is there counts, and all of it may be overwritten.

    Raises:
        InputError: it cannot be made, or holds something else than a batch.
    """

    def __init__(self, folder: Path, *, force: bool = False) -> None:
        self.folder = folder
        results = folder / RESULTS
        try:
            if folder.is_dir() and not results.is_dir() and any(folder.iterdir()) and not force:
                raise InputError(
                    f"{folder} holds files that are not of a batch; name another folder, or "
                    f"use --force"
                )
            results.mkdir(parents=True, exist_ok=True)
            found = ((_NAME.fullmatch(path.name), path) for path in sorted(results.iterdir()))
            self._names = {match[1]: path.name for match, path in found if match}
        except OSError as error:
            raise InputError(f"{folder}: cannot write there: {error.strerror}") from error
        self._done = set() if force else set(self._names)

    @property
    def table(self) -> Path:
        """The table of all."""
        return self.folder / TABLE

    def name(self, task: Task) -> str:
        """Where a task's document is, from the folder; of the first name that its log had."""
        known = self._names.get(task.key)
        if known is None:
            stem = re.sub(r"[^A-Za-z0-9._-]+", "_", log_file(task.job.log).stem)[:60]
            known = f"{stem or 'log'}-{task.key}.json"
        return f"{RESULTS}/{known}"

    def find(self, task: Task) -> Document | None:
        """The document of a task, if it is done; one that is damaged is not."""
        if task.key not in self._done:
            return None
        try:
            text = read_text(self.folder / self.name(task), MOST_BYTES, "the result")
            document = json.loads(text)
        except (InputError, ValueError, RecursionError):
            return None
        whole = isinstance(document, dict) and document.get("schema") in (SCHEMA, FAILURE)
        return document if whole else None

    def keep(self, task: Task, document: Document) -> None:
        """Keep a task's document.

        Raises:
            InputError: it cannot be written.
        """
        path = self.folder / self.name(task)
        write_whole(path, json_text(document, 2) + "\n", replace=True)
        self._names[task.key] = path.name
        self._done.add(task.key)
