"""What a person watches: Rerun layout and worker, terminal display."""
