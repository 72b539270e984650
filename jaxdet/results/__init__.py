"""Results of a run: metric values, rows, tables, summary and map."""
