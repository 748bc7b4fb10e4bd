"""One self-contained page of a past session: `page.py` writes it, `docs/report.md` describes it."""
