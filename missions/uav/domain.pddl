; An aerial robot searches a field for samples and analyses them one by one.
; Of each PDDL action, ?a is the ROSA action that is done: the knowledge base says whether it is
; feasible, before the action starts and all the while it runs.
(define (domain uav)
  (:requirements :typing :adl :durative-actions :numeric-fluents)

  (:types
    action       ; one object per ROSA action
    sample
    robot
  )

  (:predicates
    (action_feasible ?a - action)        ; set from the knowledge base
    (search_for_samples_action ?a - action)
    (pick_up_and_analyse_action ?a - action)
    (analyse_on_site_action ?a - action)
    (return_and_recharge_action ?a - action)
    (land_and_fold_gripper_action ?a - action)
    (wanted ?s - sample)                 ; sensed by the mission, as all below
    (target ?s - sample)
    (analysed ?s - sample)
    (looking ?r - robot)                 ; no sample waits to be analysed
    (gripper_folded ?r - robot)
  )

  (:functions (total-cost))

  (:durative-action search_for_samples
    :parameters (?a - action ?s - sample ?r - robot)
    :duration (= ?duration 15)
    :condition (and
      (at start (looking ?r))
      (at start (wanted ?s))
      (over all (search_for_samples_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (target ?s))
      (at end (not (looking ?r)))
      (at end (increase (total-cost) 1))
    )
  )

  (:durative-action pick_up_and_analyse
    :parameters (?a - action ?s - sample ?r - robot)
    :duration (= ?duration 18)
    :condition (and
      (at start (target ?s))
      (over all (pick_up_and_analyse_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at start (not (gripper_folded ?r)))
      (at end (analysed ?s))
      (at end (not (target ?s)))
      (at end (looking ?r))
      (at end (increase (total-cost) 1))
    )
  )

  (:durative-action analyse_on_site
    :parameters (?a - action ?s - sample ?r - robot)
    :duration (= ?duration 10)
    :condition (and
      (at start (target ?s))
      (over all (analyse_on_site_action ?a))
      (over all (action_feasible ?a))
      (over all (gripper_folded ?r))
    )
    :effect (and
      (at end (analysed ?s))
      (at end (not (target ?s)))
      (at end (looking ?r))
      (at end (increase (total-cost) 3))
    )
  )

  ; It costs more than to analyse every sample on site, so no plan recharges only for a better
  ; analysis; and it begins only when no sample waits that can be analysed on site.
  (:durative-action return_and_recharge
    :parameters (?a ?a1 ?a2 ?a3 - action ?r - robot)
    :duration (= ?duration 30)
    :condition (and
      (at start (or (looking ?r) (not (action_feasible ?a3))))
      (at start (search_for_samples_action ?a1))
      (at start (pick_up_and_analyse_action ?a2))
      (at start (analyse_on_site_action ?a3))
      (over all (return_and_recharge_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (action_feasible ?a1))
      (at end (action_feasible ?a2))
      (at end (action_feasible ?a3))
      (at end (increase (total-cost) 30))
    )
  )

  (:durative-action land_and_fold_gripper
    :parameters (?a - action ?r - robot)
    :duration (= ?duration 8)
    :condition (and
      (over all (land_and_fold_gripper_action ?a))
      (over all (action_feasible ?a))
    )
    :effect (and
      (at end (gripper_folded ?r))
      (at end (increase (total-cost) 1))
    )
  )
)
