"""What makes and checks published figures, beside its results: `python -m docs.evidence.NAME`, see README.md."""
