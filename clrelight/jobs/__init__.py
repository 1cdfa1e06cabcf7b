"""The verbs: a file or a record in, a file or a record out. The command line parses, calls one of these and prints."""
