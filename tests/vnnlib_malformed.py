"""Texts that are no query, and texts that are an odd one; what a reader may make of each."""

from __future__ import annotations

ONE = "(declare-const X_0 Real)\n(declare-const X_1 Real)\n(declare-const Y_0 Real)\n"
BOX = "(assert (<= X_0 1.0))(assert (>= X_0 0.0))(assert (<= X_1 1.0))(assert (>= X_1 0.0))\n"
GOOD = ONE + BOX + "(assert (<= Y_0 0.0))\n"
HEAD = "(vnnlib-version <2.0>)\n"
NETWORK = "(declare-network N (declare-input X real [1,2]) (declare-output Y real [1,1]))\n"
BOX_2 = "(assert (and (<= X[0,0] 1.0) (>= X[0,0] 0.0) (<= X[0,1] 1.0) (>= X[0,1] 0.0)))\n"
TWO = HEAD + NETWORK + BOX_2 + "(assert (<= Y[0,0] 0.0))\n"
MANY = "".join(f"(assert (or (<= Y_0 {n}.0) (>= Y_0 {n}.5)))" for n in range(20))
DEEP = "(or " * 100_000


def asserted(formula: str) -> str:
    return ONE + BOX + f"(assert {formula})\n"


def asserted_2(formula: str) -> str:
    return HEAD + NETWORK + BOX_2 + f"(assert {formula})\n"


ERRORS: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "no input is declared"),
    "only a comment": ("; nothing\n", "no input is declared"),
    "no assertion": (ONE, "nothing is asserted"),
    "no assertion in 2.0": (HEAD + NETWORK, "nothing is asserted"),
    "truncated": (GOOD[:-5], "never closed"),
    "truncated in 2.0": (TWO[:60], "never closed"),
    "truncated number": (GOOD[: GOOD.rindex("0.0")], "never closed"),
    "one parenthesis too many": (GOOD + ")", "a parenthesis too many"),
    "text outside": (GOOD + "unsat", "outside of parentheses"),
    "empty list": (GOOD + "()", "without a name is not supported"),
    "list as a head": (GOOD + "((assert (<= Y_0 0.0)))", "only allowed outside of other lists"),
    "100,000 open parentheses": ("(" * 100_000, "nested parentheses"),
    "100,000 nested parentheses": (ONE + "(assert " + "(" * 100_000 + ")" * 100_000 + ")", "nested parentheses"),
    "100,000 nested disjunctions": (ONE + "(assert " + DEEP + ")" * 100_001, "nested parentheses"),
    "100,000 closing parentheses": (GOOD + ")" * 100_000, "a parenthesis too many"),
    "NaN": (asserted("(<= Y_0 NaN)"), "not declared"),
    "infinity": (asserted("(<= Y_0 inf)"), "not declared"),
    "minus infinity": (asserted("(>= Y_0 -inf)"), "not declared"),
    "hexadecimal": (asserted("(<= Y_0 0x10)"), "expected a number"),
    "two points": (asserted("(<= Y_0 1.0.0)"), "expected a number"),
    "number with a comma": (asserted("(<= Y_0 1,5)"), "expected a number"),
    "fraction": (asserted("(<= Y_0 1/2)"), "expected a number"),
    "huge exponent": (asserted("(<= Y_0 1e999999)"), "out of range"),
    "absurd exponent": (asserted("(<= Y_0 1e99999999999)"), "expected a number"),
    "a million digits": (asserted(f"(<= Y_0 {'9' * 1_000_000})"), "at most 1200 characters"),
    "product that explodes": (asserted(f"(<= Y_0 (* {'1e400 ' * 200}))"), "bits"),
    "digits of another script": (asserted("(<= Y_0 ١)"), "not declared"),
    "unknown function": (asserted("(<= (sin Y_0) 0.0)"), "is not supported"),
    "relu": (asserted("(<= (max Y_0 0.0) 0.0)"), "is not supported"),
    "negation": (asserted("(not (<= Y_0 0.0))"), "is not supported"),
    "implication": (asserted("(=> (<= Y_0 0.0) (<= Y_0 1.0))"), "is not supported"),
    "strict comparison": (asserted("(< Y_0 0.0)"), "is not supported"),
    "strict comparison in 2.0": (asserted_2("(> Y[0,0] 0.0)"), "is not supported"),
    "unequal": (asserted_2("(!= Y[0,0] 0.0)"), "is not supported"),
    "division": (asserted("(<= (/ Y_0 2.0) 0.0)"), "is not supported"),
    "quantifier": (asserted("(forall ((z Real)) (<= Y_0 z))"), "is not supported"),
    "logic": ("(set-logic QF_LRA)" + GOOD, "is not supported"),
    "product of variables": (asserted("(<= (* Y_0 X_0) 0.0)"), "not linear"),
    "square of an input": (asserted("(<= (* X_0 X_0) 0.0)"), "not linear"),
    "comparison of formulas": (asserted("(<= (<= Y_0 0.0) (<= Y_0 1.0))"), "where arithmetic is required"),
    "sum of formulas": (asserted("(+ (<= Y_0 0.0) 1.0)"), "where arithmetic is required"),
    "arithmetic asserted": (asserted("(+ Y_0 1.0)"), "where a formula is required"),
    "number asserted": (asserted("1.0"), "where a formula is required"),
    "true asserted": (asserted("true"), "where a formula is required"),
    "two formulas in one assertion": (ONE + BOX + "(assert (<= Y_0 0.0) (<= Y_0 1.0))", "one formula"),
    "three sides": (asserted("(<= 0.0 Y_0 1.0)"), "two sides"),
    "one side": (asserted("(<= Y_0)"), "two sides"),
    "assertion inside": (asserted("(and (assert (<= Y_0 0.0)) (<= Y_0 0.0))"), "only allowed outside"),
    "formula outside": (GOOD + "(<= Y_0 0.0)", "is no statement"),
    "empty disjunction": (asserted("(or)"), "without anything"),
    "empty conjunction": (asserted("(and)"), "without anything"),
    "empty assertion": (ONE + BOX + "(assert)", "without anything"),
    "undeclared output": (asserted("(<= Y_1 0.0)"), "is not declared"),
    "undeclared input": (asserted("(<= X_2 0.0)"), "is not declared"),
    "used before it is declared": ("(assert (<= Y_0 0.0))" + GOOD, "is not declared"),
    "hidden neuron": (asserted("(<= H_0 0.0)"), "is not declared"),
    "leading zero in a name": (asserted("(<= Y_00 0.0)"), "is not declared"),
    "another name": ("(declare-const Z_0 Real)" + GOOD, "not a declaration"),
    "another type": ("(declare-const X_0 Int)" + GOOD, "not a declaration"),
    "declared twice": (ONE + "(declare-const X_0 Real)" + BOX, "declared twice"),
    "output declared twice": (GOOD + "(declare-const Y_0 Real)", "declared twice"),
    "a gap": ("(declare-const X_3 Real)" + GOOD, "X_2 is not declared"),
    "a million inputs too many": ("(declare-const X_5000000 Real)" + GOOD, "more than"),
    "no outputs": ("(declare-const X_0 Real)(assert (<= X_0 1.0))", "no output is declared"),
    "no lower bound": (
        ONE + BOX.replace("(assert (>= X_1 0.0))", "") + "(assert (<= Y_0 0.0))",
        "input 1 has no lower",
    ),
    "no upper bound": (
        ONE + BOX.replace("(assert (<= X_0 1.0))", "") + "(assert (<= Y_0 0.0))",
        "input 0 has no upper",
    ),
    "bounded in one case only": (
        ONE + "(assert (or (and (<= X_0 1.0) (>= X_0 0.0) (<= X_1 1.0) (>= X_1 0.0) (<= Y_0 0.0)) (<= Y_0 1.0)))",
        "input 0 has no lower",
    ),
    "bounded by an output only": (ONE + "(assert (<= X_0 Y_0))(assert (>= X_0 Y_0))", "input 0 has no lower"),
    "contradictory, and another input without bounds": (
        ONE + "(assert (<= X_0 0.0))(assert (>= X_0 1.0))(assert (<= Y_0 0.0))",
        "input 1 has no lower",
    ),
    "two to the twenty cases": (ONE + BOX + MANY, "cases"),
    "cases inside cases": (
        asserted("(and " + " ".join(f"(or (<= Y_0 {n}.0) (>= Y_0 {n}.5))" for n in range(40)) + ")"),
        "cases",
    ),
    "no version": (NETWORK, "of version 2.0"),
    "version 3": ("(vnnlib-version <3.0>)" + NETWORK, "not supported"),
    "version twice": (HEAD + HEAD + NETWORK, "first statement"),
    "version too late": (GOOD + HEAD, "first statement"),
    "version without anything": ("(vnnlib-version)" + NETWORK, "without anything"),
    "1.0 in 2.0": (HEAD + ONE, "of version 1.0"),
    "several networks": (HEAD + NETWORK + NETWORK.replace("N", "M"), "several networks"),
    "two inputs": (
        HEAD + "(declare-network N (declare-input X real [1]) (declare-input Z real [1]) (declare-output Y real [1]))",
        "not one network",
    ),
    "hidden layer": (
        HEAD
        + '(declare-network N (declare-input X real [1]) (declare-hidden H real [1] "h") (declare-output Y real [1]))',
        "is not supported",
    ),
    "no output": (HEAD + "(declare-network N (declare-input X real [1]))", "not one network"),
    "one name for both": (
        HEAD + "(declare-network N (declare-input X real [1]) (declare-output X real [1]))",
        "declared twice",
    ),
    "input outside of a network": (HEAD + "(declare-input X real [1])", "is no statement"),
    "declaration in an assertion": (asserted_2("(declare-input Z real [1])"), "where a formula"),
    "whole numbers": (HEAD + NETWORK.replace("real", "int8"), "the type 'int8'"),
    "a shape of 0": (HEAD + NETWORK.replace("[1,2]", "[1,0]"), "shape"),
    "a negative shape": (HEAD + NETWORK.replace("[1,2]", "[1,-2]"), ""),
    "a shape without numbers": (HEAD + NETWORK.replace("[1,2]", "[1,,2]"), "whole numbers"),
    "a huge shape": (HEAD + NETWORK.replace("[1,2]", "[100000,100000]"), "shape"),
    "a shape of huge numbers": (HEAD + NETWORK.replace("[1,2]", f"[{'9' * 5000}]"), "whole numbers"),
    "an unclosed shape": (HEAD + NETWORK.replace("[1,2]", "[1,2"), ""),
    "an index outside": (asserted_2("(<= Y[0,1] 0.0)"), "outside of the shape"),
    "an index too few": (asserted_2("(<= Y[0] 0.0)"), "has not 2 indices"),
    "an index too many": (asserted_2("(<= Y[0,0,0] 0.0)"), "has not 2 indices"),
    "no index": (asserted_2("(<= Y 0.0)"), "has not 2 indices"),
    "an empty index": (asserted_2("(<= Y[] 0.0)"), "has not 2 indices"),
    "a negative index": (asserted_2("(<= Y[0,-1] 0.0)"), ""),
    "an undeclared tensor": (asserted_2("(<= Z[0,0] 0.0)"), "is not declared"),
    "no UTF-8": (b"\xff\xfe" + GOOD.encode(), "not UTF-8"),
    "a byte order mark": ("\ufeff" + GOOD, "outside of parentheses"),
    "a zero byte": (GOOD.replace("Y_0 0.0", "Y_0\x000.0"), ""),
    "another kind of space": (GOOD.replace("Y_0 0.0", "Y_0\u00a00.0"), ""),
    "JSON": ('{"answer": "unsat"}', "outside of parentheses"),
    "ONNX": (b"\x08\x08\x12\x05torch", "outside of parentheses"),
}
"""Name: text, and what the message says."""

UNSAT, SAT, EITHER = "unsat", "sat", "either"

ANSWERS: dict[str, tuple[str, str]] = {
    "plain": (GOOD, EITHER),
    "2.0": (TWO, EITHER),
    "contradictory bounds": (GOOD + "(assert (>= X_0 2.0))", UNSAT),
    "contradictory bounds in all cases": (
        asserted("(or (and (>= X_0 2.0) (<= Y_0 0.0)) (and (<= X_1 -1.0) (>= Y_0 0.0)))"),
        UNSAT,
    ),
    "contradictory bounds in one case": (asserted("(or (>= X_0 2.0) (<= Y_0 1000.0))"), SAT),
    "bounds that touch": (GOOD.replace("(<= Y_0 0.0)", "(<= Y_0 1000.0)") + "(assert (>= X_0 1.0))", SAT),
    "bounds that miss by a hair": (GOOD + f"(assert (>= X_0 1.{'0' * 1000}1))", UNSAT),
    "a false constant": (GOOD + "(assert (<= 1.0 0.0))", UNSAT),
    "a true constant": (asserted("(<= 0.0 1.0)"), SAT),
    "a variable that cancels, false": (asserted("(<= (- Y_0 Y_0) -1.0)"), UNSAT),
    "a variable that cancels, true": (asserted("(>= (- Y_0 Y_0) 0.0)"), SAT),
    "a coefficient of zero": (asserted("(<= (* 0.0 Y_0) 0.0)"), SAT),
    "only bounds": (ONE + BOX, SAT),
    "an input that must be two numbers": (asserted("(and (== X_0 0.25) (== X_0 0.5))"), UNSAT),
    "equality": (asserted("(and (== X_0 0.25) (<= X_0 0.25) (<= Y_0 1000.0))"), SAT),
    "equality that fails": (asserted("(and (== X_0 0.25) (<= (+ X_0 X_1) 0.125))"), UNSAT),
    "a mixed constraint": (asserted("(<= (+ Y_0 (* 1000.0 X_0)) -500.0)"), UNSAT),
    "a scientific number": (asserted("(<= Y_0 1e3)"), SAT),
    "a number without digits before the point": (asserted("(<= Y_0 -.1e4)"), UNSAT),
    "a subtraction with one side": (asserted("(<= (- Y_0) 1000.0)"), SAT),
    "a long subtraction": (asserted("(<= (- Y_0 X_0 X_1 1000.0) 0.0)"), SAT),
    "a variable on its own other side": (asserted("(<= (- (* 2.0 X_0) X_0) -0.5)"), UNSAT),
    "a nested product": (asserted("(<= (* 2.0 (+ 1.0 (* 3.0 Y_0))) -10000.0)"), UNSAT),
    "comments everywhere": (GOOD.replace("Y_0 0.0", "Y_0 -1000.0").replace(" ", " ; (\n"), UNSAT),
    "windows": (GOOD.replace("\n", "\r\n").replace("Y_0 0.0", "Y_0 1000.0"), SAT),
    "float32 declared": (TWO.replace("real", "float32").replace("Y[0,0] 0.0", "Y[0,0] 1000.0"), SAT),
    "a scalar-like shape": (
        HEAD
        + "(declare-network N (declare-input X real [2]) (declare-output Y real []))"
        + BOX_2.replace("[0,0]", "[0]").replace("[0,1]", "[1]")
        + "(assert (>= Y 1000.0))",
        UNSAT,
    ),
    "spaces in a shape": (TWO.replace("[1,2]", "[1, 2]").replace("Y[0,0] 0.0", "Y[0, 0] -1000.0"), UNSAT),
    "a constraint of inputs alone that no input satisfies": (asserted("(>= (+ X_0 X_1) 2.5)"), UNSAT),
    "many cases": (asserted("(or " + " ".join(f"(<= Y_0 -{n}.0)" for n in range(1000, 2000)) + ")"), UNSAT),
    "numbers that no float reaches": (asserted("(<= (* 1e300 Y_0) -1e307)"), UNSAT),
}
"""Name: text, and its answer for networks whose output stays within 100 on the unit square."""
