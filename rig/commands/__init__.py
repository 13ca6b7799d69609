"""The commands, a module for each kind; they parse, call and print, and hold no arithmetic."""
