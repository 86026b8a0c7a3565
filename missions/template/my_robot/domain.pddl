#if pddl
; CHANGE: an action for each action of the model; the type `action` has one object for each.
(define (domain my_robot)
  (:requirements :strips :typing :durative-actions)
  (:types action cave)
  (:predicates
    (action_feasible ?a - action)  ; set from the knowledge base
    (explore_action ?a - action)
    (charge_action ?a - action)
    (explored ?c - cave)           ; sensed by the mission, see facts() in actions.py
    (charged ?c - cave)
  )
  (:durative-action explore
    :parameters (?a - action ?c - cave)
    :duration (= ?duration 100)
    :condition (and (over all (explore_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (explored ?c)))
  )
  ; charging is expected to make exploring feasible again; the knowledge base says whether it does
  (:durative-action charge
    :parameters (?a ?b - action ?c - cave)
    :duration (= ?duration 20)
    :condition (and
      (over all (charge_action ?a))
      (over all (action_feasible ?a))
      (at start (explore_action ?b))
    )
    :effect (and (at end (charged ?c)) (at end (action_feasible ?b)))
  )
)
#fi
