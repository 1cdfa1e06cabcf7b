"""What the five papers print, computed anew and told beside it."""
