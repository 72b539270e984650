"""The results contract: metric values, rows, tables, summary and map of a run."""
