"""A folder of photographs under known lights becomes a stack file, streaming within a memory budget."""

from clrelight.ingest.folder import IngestSummary, ingest_folder

__all__ = ["IngestSummary", "ingest_folder"]
