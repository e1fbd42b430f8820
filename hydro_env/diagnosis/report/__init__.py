"""The report of a diagnosis: page and wording."""
