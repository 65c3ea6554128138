"""Published experiments, and the study: research on top of the library and its trainers."""
