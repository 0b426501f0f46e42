"""The equations of a scene in every form, and consistent starts."""
