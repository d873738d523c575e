"""How fast the parts are on the machine at hand: the filter's step, the ingest and the aggregation.

Absolute figures belong to one machine at one moment. What compares two ways of doing the same work runs them in turn,
round by round in the same minute, and gives medians and their ratio.
"""
