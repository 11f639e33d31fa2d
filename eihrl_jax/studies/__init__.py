"""Commands of many runs: ablations, comparisons, reproductions of published figures."""
