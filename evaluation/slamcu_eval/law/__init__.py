"""The cloud's evidence law by numbers: how often it is wrong, how long it takes, and what no law could do better."""
