"""A batch: every log done once, kept as it is done, and a row for each."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from gcs_sysid.fleet.batch_table import Row, row
from gcs_sysid.fleet.jobs import Document, Job, Task, make_task
from gcs_sysid.fleet.pools import Pool, complete, reason
from gcs_sysid.fleet.store import Store


@dataclass
class Tally:
    """How far a batch has come.

    Attributes:
        total: logs.
        rows: of the logs done.
        kept: logs of these that were done before.
        verdicts: how many of each; `failed` has none.
    """

    total: int
    rows: list[Row] = field(default_factory=list)
    kept: int = 0
    verdicts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(("identified", "partial", "refused", "failed"), 0)
    )


class Batch:
    """Runs jobs whose documents are not there yet.

    Args:
        jobs: to do; logs of the same content and settings are done once.
        store: of documents.
        pool: does the work.
        show: called with the row of each log and the tally, as logs are done.
        stopped: asked now and then whether to end early, keeping what is done.
    """

    def __init__(
        self,
        jobs: list[Job],
        store: Store,
        pool: Pool,
        show: Callable[[Row, Tally], None],
        stopped: Callable[[], bool],
    ) -> None:
        self._jobs, self._store, self._pool = jobs, store, pool
        self._show, self._stopped = show, stopped
        self._copies: dict[str, list[Task]] = {}
        self._made: set[str] = set()
        self.tally = Tally(len(jobs))

    def run(self) -> list[Row]:
        """Do them; the rows of all that are done at the end.

        Raises:
            InputError: a document cannot be kept.
        """
        for task, ended in complete(self._pool, self._tasks(self._jobs), self._stopped):
            document = None if isinstance(ended, BaseException) else ended
            if document is not None:
                self._store.keep(task, document)
                self._made.add(task.key)
            why = reason(ended) if isinstance(ended, BaseException) else None
            for copy in self._copies.pop(task.key):
                self._take(copy.job, copy, document, why)
        return self.tally.rows

    def _tasks(self, jobs: Iterable[Job]) -> Iterator[Task]:
        """What is still to be done."""
        for job in jobs:
            if self._stopped():
                return
            try:
                task = make_task(job)
            except OSError as error:
                self._take(job, None, None, f"cannot read {job.log}: {error.strerror}")
                continue
            if task.key in self._copies:
                self._copies[task.key].append(task)
                continue
            document = self._store.find(task)
            if document is None:
                self._copies[task.key] = [task]
                yield task
            else:
                self.tally.kept += task.key not in self._made
                self._take(job, task, document)

    def _take(
        self, job: Job, task: Task | None, document: Document | None, error: str | None = None
    ) -> None:
        name = self._store.name(task) if task is not None and document is not None else None
        made = row(job, task, document, name, error)
        self.tally.rows.append(made)
        self.tally.verdicts[made["verdict"] or "failed"] += 1
        self._show(made, self.tally)
