"""The commands, grouped by what they are for. They parse, call and print; they calculate nothing."""
