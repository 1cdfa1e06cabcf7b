"""A folder of photographs under known lights becomes a stack file, streaming within a memory budget."""

from clrelight.ingest.folder import Folder, IngestSummary, ingest_folder, read_folder, write_photographs

__all__ = ["Folder", "IngestSummary", "ingest_folder", "read_folder", "write_photographs"]
