"""Speed and memory, measured as ratios within one run; never asserted by a test. See README.md."""
