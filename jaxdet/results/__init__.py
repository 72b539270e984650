"""Results of a run: metric values, rows, tables, summary and map.

``metric`` converts detections to metres, ``rows`` and ``tables`` to columns, and ``writer`` writes
them to Parquet files. ``layout`` names the files of a run, and ``reading`` reads them.
"""
