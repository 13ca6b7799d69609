"""The instrument put together: command line, configuration, session, control, view, report."""
