"""Published results beside ours: `neatq reproduce NAME`."""
