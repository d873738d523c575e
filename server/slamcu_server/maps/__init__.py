"""HD maps: import, versions, and the features that vehicles and providers fetch."""
