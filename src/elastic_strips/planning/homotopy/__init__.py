"""Classes of paths: on which sides of the obstacles the base passes, and strips on several sides at once.

The room's package exports what users need of it.
"""
