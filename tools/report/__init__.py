"""Self-contained HTML pages about a semantic database or runs, and the same as figures, tables and recordings."""

from tools.report.write import Wanted, write_report

__all__ = ["Wanted", "write_report"]
