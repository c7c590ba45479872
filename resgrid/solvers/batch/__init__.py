"""Many circuits that differ in their conductances only, such as the chips of one wafer."""
