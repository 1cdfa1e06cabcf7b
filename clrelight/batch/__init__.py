"""One job on many stacks: by processes of this machine or of a cluster, with a journal, so that nothing is lost."""

from clrelight.batch.plan import make_tasks, read_listing
from clrelight.batch.run import Batch, run_batch
from clrelight.batch.task import Outcome, Task

__all__ = ["Batch", "Outcome", "Task", "make_tasks", "read_listing", "run_batch"]
