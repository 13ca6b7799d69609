"""MCAP records: schemas, writer, reader, recovery."""
