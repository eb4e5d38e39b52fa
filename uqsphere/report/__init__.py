"""What a person reads of a run: one page, its figures, the terminal's summary, and runs side by
side.
"""

from .page import page_files, write_page
from .terminal import summary

__all__ = ["page_files", "summary", "write_page"]
