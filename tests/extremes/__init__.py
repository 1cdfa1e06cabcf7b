"""Numbers at the extremes: every statement with its figure, against float64."""
