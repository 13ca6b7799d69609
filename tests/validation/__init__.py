"""What README and docs claim, each claim a row: how it is tested, what came out, what it must be.

``python -m tests.validation [--quick] [--again] [NAME...]`` measures rows and writes ``docs/validation.json``
and the page that follows from it, ``docs/validation.md``. A row is declared in `catalogue`; what it measures
shares nothing with the code that it judges: certified values, another program, a definition of a standard.
"""
