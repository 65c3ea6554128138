"""The training window: a page in the browser that looks on while a run trains, and changes it."""
