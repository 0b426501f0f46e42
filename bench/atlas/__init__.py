"""The failure atlas: experiments that show failures of methods, and remedies."""
