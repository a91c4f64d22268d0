"""Classes of paths: on which sides of the obstacles the base passes, and strips on several sides at once.

The package ``planning`` exports the names that users need.
"""
