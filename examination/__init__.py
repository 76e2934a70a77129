"""Examination of sma_bench: never installed; run from a checkout by ./bench blind, check, perf."""
