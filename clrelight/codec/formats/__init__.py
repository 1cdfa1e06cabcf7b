"""The codecs: one file each, with what is its own beside it."""
